"""Where command errors enter: between whoever drafts and the interface that executes."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.stream import ErrorStream, Seed, seeds_of
from lerobot_dexflex.conventions import FINGERTIPS, STATE, TACTILE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads, solve_fingertips
from lerobot_dexflex.hand.model import HAND_JOINTS
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.interfaces.wrapper import WrappedInterface

_HAND = len(HAND_JOINTS)


class DisturbedInterface(WrappedInterface):
    """Spoils every draft on its way to an interface. Satisfies `Interface`; call `begin` before an episode.

    A draft leads from the executed command to positions where the fingertips should be, so errors are those
    of positions: a delayed draft leads to the positions of an old one, jitter does not add up, and a removed
    finger leaves from where it is felt, so that it lets go at once however deep the squeeze was (its later
    steps go on outward: nobody knows when the removal ends). Planned joints are moved so that their
    fingertips are off by as much, by the inverse kinematics of `raw`.

    Args:
        inner: Any interface.
        errors: What goes wrong with the drafts.
        held: Whether drafts repeat their first step, as a glove's do; see `ErrorStream.step`.
    """

    def __init__(self, inner: Interface, errors: CommandErrors, held: bool = False) -> None:
        super().__init__(inner)
        self.errors, self._held = errors, held
        self._removes = "removal" in errors.families
        self._stream = ErrorStream(0)
        self._outside: Tensor | None = None
        self._last: Tensor | None = None

    def begin(self, seeds: Sequence[Seed]) -> None:
        """Begin an episode per row, whose errors follow from its seed: the same for every interface."""
        self._stream = ErrorStream(len(seeds))
        for row, seed in enumerate(seeds):
            self._stream.begin(row, self.errors, seeds_of(self.errors, seed))
        self._outside = self._last = None

    @property
    def in_event(self) -> NDArray[np.bool_]:
        """See `ErrorStream.in_event`."""
        return self._stream.in_event

    @property
    def events(self) -> list[ErrorEvent]:
        """See `ErrorStream.events`."""
        return self._stream.events

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all; without `begin`, errors are drawn on."""
        super().reset(mask)
        if len(self._stream):
            self._stream.restart(mask)
        if mask is None or self._last is None:
            self._last = None
        else:
            self._last = self._last.masked_fill(mask.to(self._last.device)[:, None], torch.nan)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets for what arrives of the draft.

        Raises:
            DexFlexError: If `begin` was called for another number of hands, or removals lack touch; else as
                `Interface.step`.
        """
        if len(draft) != len(self._stream):
            raise DexFlexError(
                f"{self.errors.name!r} was begun for {len(self._stream)} hands, but {len(draft)} drafts "
                "came; call `begin` with a seed per hand before an episode."
            )
        spoil = self._joints if self.command_space == "joint" else self._displacements
        return self.inner.step(observation, spoil(observation, draft.double()).to(draft.dtype))

    def _displacements(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        start = self.inner.start(observation)
        if self._stream.late:
            draft = _moved_first(self._stream.delayed(_moved_first(draft, start)), -start)
        return self._spoilt(observation, draft, start)

    def _joints(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        start = self.inner.start(observation)
        draft = self._stream.delayed(draft)
        joints = draft.flatten(0, 1)
        tips = fingertips(joints).unflatten(0, draft.shape[:2])  # (batch, steps, 4, 3)
        motion = torch.diff(tips, dim=1, prepend=start[:, None])
        spoilt = self._spoilt(observation, motion, start)
        goals = (start[:, None] + spoilt.cumsum(1)).flatten(0, 1)
        solved = solve_fingertips(goals, joints).view_as(draft)
        struck = (spoilt != motion).flatten(3).any(-1).any(1)[:, None]  # (batch, 1, 4)
        draft = torch.where(_per_joint(struck), solved, draft)
        still = self._stream.where(draft, "freeze", "dropout")[..., 0]
        draft = torch.where(_per_joint(still), self._previous(observation)[:, None], draft)
        self._last = draft[:, 0]
        return draft

    def _previous(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the joints that were passed on last, or after a reset the measured ones [rad]."""
        measured = observation[STATE][:, -_HAND:].double()
        return measured if self._last is None else torch.where(self._last.isnan(), measured, self._last)

    def _spoilt(self, observation: Mapping[str, Tensor], motion: Tensor, start: Tensor) -> Tensor:
        """Return displacements (batch, steps, 4, 3) from `start` (batch, 4, 3) on with their errors [m]."""
        loads, inward = self._felt(observation, start)
        moved = self._stream.step(motion, loads, inward, absolute=True, held=self._held)
        if not self._removes:
            return moved
        felt = observation[FINGERTIPS].double().unflatten(1, (4, 3))
        leaving = self._stream.where(moved, "removal")[:, 0]
        further = felt if self._outside is None else self._outside + self._stream.outward(moved)[:, 0]
        self._outside = torch.where(leaving, further, felt)
        first = torch.where(leaving, self._outside - start, moved[:, 0])
        return torch.cat([first[:, None], moved[:, 1:]], 1)

    def _felt(self, observation: Mapping[str, Tensor], start: Tensor) -> tuple[Tensor, Tensor]:
        """Return loads [N] (batch, 4) and inward normals (batch, 4, 3) of the fingertips, for removals."""
        if not self._removes:
            return torch.zeros_like(start[..., 0]), torch.zeros_like(start)
        if missing := [key for key in (TACTILE, FINGERTIPS) if key not in observation]:
            raise DexFlexError(
                f"{self.errors.name!r} needs touch: the observation lacks {', '.join(missing)}."
            )
        loads = observation[TACTILE].double().unflatten(1, (4, -1)).sum(-1)
        return loads, pads(observation[STATE][:, -_HAND:].double())[1]


def _moved_first(draft: Tensor, offset: Tensor) -> Tensor:
    """Return displacements whose first step leads further by `offset` (batch, 4, 3)."""
    return torch.cat([(draft[:, 0] + offset)[:, None], draft[:, 1:]], 1)


def _per_joint(fingers: Tensor) -> Tensor:
    """Return a mask of fingers (batch, steps, 4) as one of their joints (batch, steps, 16)."""
    return fingers.repeat_interleave(4, -1)
