"""The state that all interfaces share: what the hand was last told to do, row by row."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_dexflex.conventions import CONTROL_PERIOD, STATE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import leap
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.interfaces.protocol import CommandSpace

N_JOINTS = len(leap.LINKS)
LARGEST_STEP = leap.MAX_SPEED * CONTROL_PERIOD
"""Largest change of a joint target in a control step [rad]; ordinary commands stay below .35."""
RUNAWAY, HELD = 0.030, 0.002
"""A commanded fingertip that is farther from where its joints put it has run away, and is held nearer [m].
Commands run ahead in ordinary work as well, since the posture is tied and joints end: `raw` by up to 14 mm
under noise and a scale of 1.5, `reflex` by up to 23 mm."""


class CommandedHand:
    """Previous joint command (batch, 16) [rad] and commanded fingertips (batch, 4, 3) [m], in float64.

    This is the last thing below every interface, and bounds what leaves it: no joint target moves faster than
    the servo can, and no commanded fingertip runs away from where its joints can bring it.

    Rows are never written in place: LeRobot acts under `torch.inference_mode`, whose tensors may not be
    modified outside of it.
    """

    def __init__(self) -> None:
        self.joints: Tensor | None = None
        self.tips: Tensor | None = None
        self._before: tuple[Tensor, Tensor] | None = None
        self._wound: Tensor | None = None
        self._fresh: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the command of the rows in `mask` (batch,), or all of it."""
        if mask is None or self.joints is None or self._fresh is None:
            self.joints = self.tips = self._wound = self._fresh = None
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
        if self.joints is None or self.tips is None or self._wound is None or self._fresh is None:
            self.joints, self.tips = measured, fingertips(measured)
            self._fresh = torch.zeros(len(measured), dtype=torch.bool, device=measured.device)
            self._wound = torch.zeros(self.tips.shape[:2], dtype=torch.bool, device=measured.device)
        elif len(measured) != len(self.joints):
            raise DexFlexError(
                f"The batch changed from {len(self.joints)} to {len(measured)} hands without a reset; "
                "call `reset()` before a batch of another size."
            )
        elif self._fresh.any():
            fresh = self._fresh
            self.joints = torch.where(fresh[:, None], measured, self.joints)
            self.tips = torch.where(fresh[:, None, None], fingertips(measured), self.tips)
            self._wound = self._wound & ~fresh[:, None]
            self._fresh = torch.zeros_like(fresh)
        return self.joints, self.tips

    def execute(self, joints: Tensor, tips: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Bound a command, remember and return it; what is within the bounds passes bit for bit.

        A fingertip that was commanded `RUNAWAY` beyond where its joints put it is held `HELD` beyond, until
        it comes back by itself: a command that goes the other way then takes effect at once.

        Args:
            joints: Joint targets [rad]. Shape (batch, 16).
            tips: Commanded fingertips [m], (batch, 4, 3); None is where the bounded joints put them.

        Raises:
            DexFlexError: If joints hold NaN or infinity; nothing is remembered then.
        """
        assert self.joints is not None
        assert self.tips is not None
        assert self._wound is not None
        self._before = self.joints, self.tips
        _refuse_non_finite("The command", joints)
        joints = joints.clamp(self.joints - LARGEST_STEP, self.joints + LARGEST_STEP)
        reached = fingertips(joints)
        lead = (reached if tips is None else tips) - reached  # (batch, 4, 3)
        size = lead.norm(dim=-1)
        self._wound = (size > RUNAWAY) | (self._wound & (size > HELD))
        held = reached + lead * (HELD / size.clamp(min=HELD))[..., None]
        self.joints = joints
        self.tips = torch.where(self._wound[..., None], held, reached if tips is None else tips)
        return self.joints, self.tips

    def undo(self) -> None:
        """Take the last command back, so that another can take its place."""
        assert self._before is not None
        self.joints, self.tips = self._before


class CommandedInterface:
    """What every interface that commands the hand itself shares: its state, its start and its motion."""

    name: str
    command_space: CommandSpace

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

    def move(self, observation: Mapping[str, Tensor], displacement: Tensor) -> Tensor:
        """Displace the commanded fingertips by (batch, 4, 3) [m]; returns joints (batch, 16) in float64."""
        joints, tips = self._hand.start(observation)
        tips = tips + displacement
        return self._hand.execute(solve_fingertips(tips, joints), tips)[0]

    def move_instead(self, observation: Mapping[str, Tensor], displacement: Tensor) -> Tensor:
        """Take this step's command back and `move` from where it began."""
        self._hand.undo()
        return self.move(observation, displacement)


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
    if state.ndim != 2 or state.shape[1] < N_JOINTS:
        raise DexFlexError(
            f"'{STATE}' must have shape (batch, >= {N_JOINTS}), the hand's joints last [rad]. "
            f"Got {tuple(state.shape)}."
        )
    joints = state[:, -N_JOINTS:]
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
