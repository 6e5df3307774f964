"""What all interfaces share: where the hand is, what it was last told to do, and how it is moved."""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.conventions import CONTROL_PERIOD, STATE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, joint_limits, leads, solve_fingertips
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.protocol import CommandSpace


class Measured(NamedTuple):
    """Where the hand is."""

    joints: Tensor
    """[rad], float64. Shape (batch, joints)."""
    tips: Tensor
    """Fingertips in the palm frame [m], float64. Shape (batch, fingers, 3)."""


class CommandedHand:
    """The previous command, row by row; the last thing below every interface.

    No joint target moves faster than the servo can follow, so a jump of an encoder or of a draft never
    becomes a jump of the hand. Rows are never written in place: LeRobot acts under `torch.inference_mode`,
    whose tensors may not be modified outside of it.

    Args:
        hand: The hand.
    """

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self.largest_step = torch.tensor(hand.joint_speeds) * CONTROL_PERIOD
        """Largest change of each joint target in a control step [rad]: what its servo follows. (joints,)."""
        self._command: Tensor | None = None
        self._posture: Tensor | None = None
        self._fresh: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the command of the rows in `mask` (batch,), or all of it."""
        if mask is None or self._fresh is None:
            self._command = self._posture = self._fresh = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._fresh.device)
        if mask.shape != self._fresh.shape:
            raise DexFlexError(
                f"`mask` must be one bool per row, shape {tuple(self._fresh.shape)}. Got {tuple(mask.shape)}."
            )
        self._fresh = self._fresh | mask

    def look(self, observation: Mapping[str, Tensor]) -> Measured:
        """Return where the hand is; rows that were just reset begin there.

        Args:
            observation: Holds `observation.state`, shape (batch, >= joints) [rad].
        """
        joints = _measured_joints(self.hand, observation)
        if self._command is None or self._posture is None or self._fresh is None:
            self._command = self._posture = joints
            self._fresh = torch.zeros(len(joints), dtype=torch.bool, device=joints.device)
        elif len(joints) != len(self._command):
            raise DexFlexError(
                f"The batch changed from {len(self._command)} to {len(joints)} hands without a reset; "
                "call `reset()` before a batch of another size."
            )
        elif self._fresh.any():
            fresh = self._fresh[:, None]
            self._command = torch.where(fresh, joints, self._command)
            self._posture = torch.where(fresh, joints, self._posture)
            self._fresh = torch.zeros_like(self._fresh)
        return Measured(joints, fingertips(self.hand, joints))

    def execute(self, joints: Tensor, posture: Tensor | None = None) -> Tensor:
        """Bound joint targets, remember and return them; what is within the bounds passes bit for bit.

        Args:
            joints: Joint targets [rad]. Shape (batch, joints).
            posture: Joints without the grip, to which the next inverse kinematics is tied; `joints` if None.

        Raises:
            DexFlexError: If joints hold NaN or infinity; nothing is remembered then.
        """
        assert self._command is not None
        _refuse_non_finite("The command", joints)
        step = self.largest_step.to(joints)
        bounded = joints.clamp(self._command - step, self._command + step)
        self._command, self._posture = bounded, bounded if posture is None else posture
        return bounded

    @property
    def posture(self) -> Tensor:
        """Joints without the grip of the previous command [rad]. Shape (batch, joints)."""
        assert self._posture is not None
        return self._posture


class CommandedInterface(ABC):
    """What every interface shares that moves the fingertips itself.

    `gain` scales the motion that it asks of the hand (not the grip): a method's `@0.5`.

    Args:
        hand: The hand that it serves.
    """

    name: str
    command_space: CommandSpace = "draft"

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self.gain = 1.0
        self._hand = CommandedHand(hand)
        self._motion: Tensor | None = None

    @property
    def motion(self) -> Tensor | None:
        """See `Interface.motion`."""
        return self._motion

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self._hand.reset(mask)

    def move(
        self, measured: Measured, motion: Tensor, push: Tensor | None = None, torques: Tensor | None = None
    ) -> Tensor:
        """Move the fingertips from where they are measured, and press.

        Args:
            measured: Where the hand is.
            motion: Of the fingertips [m]. Shape (batch, fingers, 3).
            push: What a touch servo adds to it [m]. Shape (batch, fingers, 3).
            torques: Joint torques of the grip [N m], realised by leading the joints. Shape (batch, joints).

        Returns:
            Joint targets [rad], float64. Shape (batch, joints).
        """
        motion = self.gain * motion
        goal = measured.tips + (motion if push is None else motion + push)
        posture = solve_fingertips(self.hand, goal, self._hand.posture)
        joints = posture
        if torques is not None:
            lower, upper = (limit.to(posture) for limit in joint_limits(self.hand))
            joints = (posture + leads(self.hand, torques)).clamp(lower, upper)
        joints = self._hand.execute(joints, posture)
        self._motion = motion
        return joints

    @contextlib.contextmanager
    def all_or_nothing(self, *parts: object) -> Iterator[None]:
        """Forget a step that fails: neither the interface nor its parts remember anything of it.

        Memories are tensors that are replaced and never written in place, so it is enough to keep references.
        """
        whole = (self, self._hand, *parts)
        before = [dict(vars(part)) for part in whole]
        try:
            yield
        except BaseException:
            for part, memory in zip(whole, before, strict=True):
                vars(part).clear()
                vars(part).update(memory)
            raise

    @abstractmethod
    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Execute the first step of a draft; see `Interface.step`."""


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


def _measured_joints(hand: Hand, observation: Mapping[str, Tensor]) -> Tensor:
    if STATE not in observation:
        raise DexFlexError(
            f"The observation lacks '{STATE}', the measured joints [rad]. Got keys: {sorted(observation)}."
        )
    state = observation[STATE]
    if state.ndim != 2 or state.shape[1] < hand.n_joints:
        raise DexFlexError(
            f"'{STATE}' must have shape (batch, >= {hand.n_joints}), the joints of the hand '{hand.name}' "
            f"last [rad]. Got {tuple(state.shape)}."
        )
    joints = state[:, -hand.n_joints :]
    _refuse_non_finite(f"'{STATE}'", joints)
    return joints.double()


def _refuse_non_finite(what: str, values: Tensor) -> None:
    finite = torch.isfinite(values).flatten(1).all(1)
    if not finite.all():
        rows = (~finite).nonzero().flatten().tolist()
        raise DexFlexError(f"{what} holds NaN or infinity in rows {rows}; nothing was executed.")
