"""The state that all interfaces share: what the hand was last told to do, row by row."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_dexflex.conventions import STATE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips

HAND_JOINTS = 16


class CommandedHand:
    """Previous joint command (batch, 16) [rad] and commanded fingertips (batch, 4, 3) [m], in float64.

    Rows are never written in place: LeRobot acts under `torch.inference_mode`, whose tensors may not be
    modified outside of it.
    """

    def __init__(self) -> None:
        self.joints: Tensor | None = None
        self.tips: Tensor | None = None
        self._fresh: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the command of the rows in `mask` (batch,), or all of it."""
        if mask is None or self.joints is None or self._fresh is None:
            self.joints = self.tips = self._fresh = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self.joints.device)
        if mask.shape != self._fresh.shape:
            raise DexFlexError(
                f"`mask` must be one bool per row, shape {tuple(self._fresh.shape)}. Got {tuple(mask.shape)}."
            )
        self._fresh = self._fresh | mask

    def start(
        self, observation: Mapping[str, Tensor], initial: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return joints and fingertips of the previous command.

        Args:
            observation: Holds `observation.state`, shape (batch, >= 16) [rad].
            initial: Joints [rad] (batch, 16) that rows begin from after a reset; measured ones if None.
        """
        measured = _measured_joints(observation)
        if initial is not None:
            measured = _checked_initial(initial, measured)
        if self.joints is None or self.tips is None or self._fresh is None:
            self.joints, self.tips = measured, fingertips(measured)
            self._fresh = torch.zeros(len(measured), dtype=torch.bool, device=measured.device)
        elif len(measured) != len(self.joints):
            raise DexFlexError(
                f"The batch changed from {len(self.joints)} to {len(measured)} hands without a reset; "
                "call `reset()` before a batch of another size."
            )
        elif self._fresh.any():
            fresh = self._fresh
            self.joints = torch.where(fresh[:, None], measured, self.joints)
            self.tips = torch.where(fresh[:, None, None], fingertips(measured), self.tips)
            self._fresh = torch.zeros_like(fresh)
        return self.joints, self.tips

    def execute(self, joints: Tensor, tips: Tensor) -> None:
        """Remember what was commanded: joints (batch, 16) [rad] and fingertips (batch, 4, 3) [m]."""
        self.joints, self.tips = joints, tips


class CommandedInterface:
    """What every interface that commands the hand itself shares: its state and how it begins."""

    def __init__(self) -> None:
        self._hand = CommandedHand()

    @property
    def command(self) -> Tensor | None:
        """Executed commanded fingertips [m]. Shape (batch, 4, 3)."""
        return self._hand.tips

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self._hand.reset(mask)

    def start(self, observation: Mapping[str, Tensor], initial: Tensor | None = None) -> Tensor:
        """Return the commanded fingertips before this step [m], (batch, 4, 3); see `Interface.start`."""
        return self._hand.start(observation, initial)[1]

    def follow(self, joints: Tensor, tips: Tensor) -> None:
        """Go on from what was executed instead of the last step: joints (batch, 16), tips (batch, 4, 3)."""
        self._hand.execute(joints, tips)


def check_draft(draft: Tensor, element: tuple[int, ...], rows: int, meaning: str) -> Tensor:
    """Return the draft in float64, or refuse it.

    Args:
        draft: Must have the shape (rows, horizon >= 1, *element) and finite values.
        element: Shape of one step.
        rows: Number of hands.
        meaning: What one step is, for the message.
    """
    shape = tuple(draft.shape)
    if len(shape) != 2 + len(element) or shape[0] != rows or shape[1] < 1 or shape[2:] != element:
        wanted = ", ".join(["horizon", *map(str, element)])
        raise DexFlexError(f"A draft must have shape ({rows}, {wanted}): {meaning}. Got {shape}.")
    _refuse_non_finite("The draft", draft)
    return draft.double()


def _measured_joints(observation: Mapping[str, Tensor]) -> Tensor:
    if STATE not in observation:
        raise DexFlexError(
            f"The observation lacks '{STATE}', the measured joints [rad]. Got keys: {sorted(observation)}."
        )
    state = observation[STATE]
    if state.ndim != 2 or state.shape[1] < HAND_JOINTS:
        raise DexFlexError(
            f"'{STATE}' must have shape (batch, >= {HAND_JOINTS}), the hand's joints last [rad]. "
            f"Got {tuple(state.shape)}."
        )
    joints = state[:, -HAND_JOINTS:]
    _refuse_non_finite(f"'{STATE}'", joints)
    return joints.double()


def _checked_initial(initial: Tensor, measured: Tensor) -> Tensor:
    if initial.shape != measured.shape:
        raise DexFlexError(
            f"`initial` must be a joint command [rad] of shape {tuple(measured.shape)}. "
            f"Got {tuple(initial.shape)}."
        )
    _refuse_non_finite("`initial`", initial)
    return initial.to(measured)


def _refuse_non_finite(what: str, values: Tensor) -> None:
    finite = torch.isfinite(values).flatten(1).all(1)
    if not finite.all():
        rows = (~finite).nonzero().flatten().tolist()
        raise DexFlexError(f"{what} holds NaN or infinity in rows {rows}; nothing was executed.")
