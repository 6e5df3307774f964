"""The state that all interfaces share: what the hand was last told to do, row by row."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.conventions import CONTROL_PERIOD, STATE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import leap
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.interfaces.protocol import CommandSpace

N_JOINTS = len(leap.LINKS)
LARGEST_STEP = leap.MAX_SPEED * CONTROL_PERIOD
"""Largest change of a joint target in a control step [rad]. Ordinary commands ask for up to .27, and those of
`reflex` for .50."""
RUNAWAY, FOLLOWED = 0.030, 0.002
"""A commanded fingertip farther from where its joints put it has run away, and one nearer than the second is
followed [m]. Commands run ahead in ordinary work too, since the posture is tied and joints end: `raw` by up
to 14 mm under noise and a scale of 1.5, `dexflex` by 19 mm under a bias, `reflex` by 23 mm."""


STUCK = 0.001
"""Joints that bring a fingertip less than this toward its command in a step do not approach it [m]."""


class _Leash(NamedTuple):
    """What is known of each finger's command running away."""

    held: Tensor
    """Whether it did and has not been told to come back. Shape (batch, 4)."""
    away: Tensor
    """Unit vector in which it did. Shape (batch, 4, 3)."""
    followed: Tensor
    """Joints that last followed or approached their command [rad]. Shape (batch, 4, 4)."""


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
        self._leash: _Leash | None = None
        self._fresh: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the command of the rows in `mask` (batch,), or all of it."""
        if mask is None or self.joints is None or self._fresh is None:
            self.__init__()
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
        if self.joints is None or self.tips is None or self._leash is None or self._fresh is None:
            self.joints, self.tips = measured, fingertips(measured)
            self._fresh = torch.zeros(len(measured), dtype=torch.bool, device=measured.device)
            held = torch.zeros(self.tips.shape[:2], dtype=torch.bool, device=measured.device)
            self._leash = _Leash(held, torch.zeros_like(self.tips), measured.unflatten(1, (4, 4)))
        elif len(measured) != len(self.joints):
            raise DexFlexError(
                f"The batch changed from {len(self.joints)} to {len(measured)} hands without a reset; "
                "call `reset()` before a batch of another size."
            )
        elif self._fresh.any():
            fresh = self._fresh
            self.joints = torch.where(fresh[:, None], measured, self.joints)
            self.tips = torch.where(fresh[:, None, None], fingertips(measured), self.tips)
            followed = torch.where(fresh[:, None], measured, self._leash.followed.flatten(1))
            held = self._leash.held & ~fresh[:, None]
            self._leash = self._leash._replace(held=held, followed=followed.unflatten(1, (4, 4)))
            self._fresh = torch.zeros_like(fresh)
        return self.joints, self.tips

    def execute(self, joints: Tensor, tips: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Bound a command, remember and return it; what is within the bounds passes bit for bit.

        A commanded tip that is `RUNAWAY` beyond where its joints put it is cut off there while the joints
        still approach it. Once they do not, the finger goes back to the joints that last followed, and stays
        there until it is told to come back. It then does so at once: neither has the command a way to go, nor
        are the joints stretched until inverse kinematics cannot bend them any more.

        Args:
            joints: Joint targets [rad]. Shape (batch, 16).
            tips: Commanded fingertips [m], (batch, 4, 3); None is where the bounded joints put them.

        Raises:
            DexFlexError: If joints hold NaN or infinity; nothing is remembered then.
        """
        assert self.joints is not None
        assert self.tips is not None
        _refuse_non_finite("The command", joints)
        before = self.joints, self.tips
        joints = self._no_faster(joints)
        reached = fingertips(joints)
        if tips is not None:
            joints, tips = self._leashed(joints, tips, reached)
        self.joints, self.tips, self._before = joints, reached if tips is None else tips, before
        return self.joints, self.tips

    def _no_faster(self, joints: Tensor) -> Tensor:
        assert self.joints is not None
        return joints.clamp(self.joints - LARGEST_STEP, self.joints + LARGEST_STEP)

    def _leashed(self, joints: Tensor, tips: Tensor, reached: Tensor) -> tuple[Tensor, Tensor]:
        """Return joints and tips of which none runs away; `reached` is where the joints put the tips."""
        assert self._leash is not None
        held, away, followed = self._leash
        lead = tips - reached
        size = lead.norm(dim=-1)  # (batch, 4)
        near = size < FOLLOWED
        far = size > RUNAWAY
        if (far | held).any():
            direction = lead / size.clamp(min=FOLLOWED)[..., None]
            stuck = far & (self._approach(reached, direction) < STUCK)
            away = torch.where((stuck & ~held)[..., None], direction, away)
            held = stuck | (held & ~self._returns(tips, size, away))
            near = (near | far) & ~held
            tips = torch.where(far[..., None], reached, tips)
            still = self._no_faster(followed.flatten(1))
            joints = torch.where(held.repeat_interleave(4, 1), still, joints)
            tips = torch.where(held[..., None], fingertips(joints), tips)
        followed = torch.where(near[..., None], joints.unflatten(1, (4, 4)), followed)
        self._leash = _Leash(held, away, followed)
        return joints, tips

    def _approach(self, reached: Tensor, direction: Tensor) -> Tensor:
        """Return how far this step brings the tips in a direction [m]. Shape (batch, 4)."""
        assert self.joints is not None
        return ((reached - fingertips(self.joints)) * direction).sum(-1)

    def _returns(self, tips: Tensor, size: Tensor, away: Tensor) -> Tensor:
        """Return which commands go back, or sideways so that the joints follow. Shape (batch, 4)."""
        assert self.tips is not None
        asked = tips - self.tips
        outward, length = (asked * away).sum(-1), asked.norm(dim=-1)
        return (outward < 0) | ((outward < length / 2) & (size < length / 2))

    def undo(self) -> None:
        """Take the last command back, so that another can take its place."""
        assert self._before is not None
        self.joints, self.tips = self._before


class CommandedInterface(ABC):
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

    @abstractmethod
    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Execute the first step of a draft; see `Interface.step`."""

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
