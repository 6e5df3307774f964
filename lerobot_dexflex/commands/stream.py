"""The command errors of a batch of hands, step by step, on the commands' device."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands import effects
from lerobot_dexflex.commands.draws import ErrorEvent, RowErrors
from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors

Seed = int | tuple[int, ...]
"""Of numpy's generators."""


class ErrorStream:
    """Spoils the commands of every hand of a batch by its own errors and its own random numbers.

    Args:
        rows: Number of hands; nothing goes wrong in a row before its `begin`.
    """

    def __init__(self, rows: int) -> None:
        self._rows = [RowErrors(NO_ERRORS) for _ in range(rows)]

    def __len__(self) -> int:
        return len(self._rows)

    def begin(self, row: int, errors: CommandErrors, seeds: Sequence[Seed | np.random.Generator]) -> None:
        """Begin an episode in a row.

        Args:
            row: Of the batch.
            errors: What goes wrong.
            seeds: Of every error's random numbers, or its generator.
        """
        self._rows[row] = RowErrors(errors, [np.random.default_rng(seed) for seed in seeds], row)

    def restart(self, mask: Tensor | None = None) -> None:
        """Begin another episode in the rows of `mask`, shape (batch,), or in all, with further numbers."""
        chosen = [True] * len(self) if mask is None else mask.tolist()
        for row, again in zip(self._rows, chosen, strict=True):
            if again:
                row.restart()

    @property
    def in_event(self) -> NDArray[np.bool_]:
        """Rows whose last command was one of an event (removal, freeze, dropout). Shape (batch,)."""
        return np.array([any(schedule.active for schedule in row.schedules) for row in self._rows])

    @property
    def events(self) -> list[ErrorEvent]:
        """What happened in the running episodes, row by row."""
        return [event for row in self._rows for event in row.events]

    def fingers(self, *families: str) -> NDArray[np.bool_]:
        """Return whom the running events of these families strike. Shape (batch, 4)."""
        struck = np.zeros((len(self), 4), bool)
        for k, row in enumerate(self._rows):
            for schedule in row.schedules:
                if schedule.active and schedule.error.family in families:
                    struck[k, slice(None) if schedule.finger is None else schedule.finger] = True
        return struck

    @property
    def late(self) -> bool:
        """Whether a row's commands come late."""
        return any(row.lag for row in self._rows)

    def delayed(self, now: Tensor) -> Tensor:
        """Return each row of a tensor as it was when the command that arrives now was given.

        Call it once per step, before `step`.
        """
        if not self.late:
            return now
        return torch.stack([row.delayed(value) for row, value in zip(self._rows, now, strict=True)])

    def step(
        self,
        motion: Tensor,
        loads: Tensor,
        inward: Tensor,
        *,
        absolute: bool = False,
        held: bool = False,
    ) -> Tensor:
        """Return the displacements with the errors of this control step, delays apart. Shape as `motion`.

        Args:
            motion: Displacements of the commanded fingertips from this step on [m]. Shape (batch, H, 4, 3).
            loads: Normal force of each fingertip [N]. Shape (batch, 4).
            inward: Contact normals into the object. Shape (batch, 4, 3).
            absolute: Whether the first displacement leads from where the hand is to a position of its own.
            held: Whether the later steps repeat the first, as a glove's do that knows no future: then its
                error is theirs too.
        """
        felt, normals = _array(loads), _array(inward)
        for k, row in enumerate(self._rows):
            row.advance(felt[k], normals[k])
        ahead = 1 if held else motion.shape[1]
        offsets = np.stack([row.offsets(ahead, absolute) for row in self._rows])
        factors = np.array([row.factor for row in self._rows]).reshape(-1, 1, 1, 1)
        moved = effects.scaled(motion, _like(factors, motion))
        moved = effects.shaken(moved, _like(offsets, motion))
        moved = effects.stopped(moved, self.where(motion, "freeze", "dropout"))
        return effects.leaving(moved, self.where(motion, "removal"), self.outward(motion))

    def where(self, like: Tensor, *families: str) -> Tensor:
        """Return `fingers` on a tensor's device. Shape (batch, 1, 4, 1)."""
        return torch.as_tensor(self.fingers(*families), device=like.device)[:, None, :, None]

    def outward(self, like: Tensor) -> Tensor:
        """Return the displacement of removed fingers [m] on a tensor's device. Shape (batch, 1, 4, 3)."""
        found = np.zeros((len(self), 1, 4, 3))
        for k, row in enumerate(self._rows):
            for schedule in row.schedules:
                if schedule.active and schedule.error.family == "removal":
                    found[k, 0, schedule.finger] = schedule.outward
        return _like(found, like)


def seeds_of(errors: CommandErrors, seed: Seed) -> list[Seed]:
    """Return the seeds of an episode's errors; a family's does not depend on which others there are."""
    first = seed if isinstance(seed, tuple) else (seed,)
    return [(*first, *error.row.salt) for error in errors]


def _array(values: Tensor) -> NDArray[np.float64]:
    return values.detach().double().cpu().numpy()


def _like(values: NDArray[np.float64], like: Tensor) -> Tensor:
    return torch.as_tensor(values, dtype=like.dtype, device=like.device)
