"""The command errors of a batch of hands, step by step, on the commands' device."""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands import effects
from lerobot_dexflex.commands.draws import ErrorEvent, RowErrors
from lerobot_dexflex.commands.families import LEVEL_SALT, NO_ERRORS, CommandErrors
from lerobot_dexflex.hands import Hand

Seed = int | tuple[int, ...]
"""Of numpy's generators."""


class ErrorStream:
    """Spoils the commands of every hand of a batch by its own errors and its own random numbers.

    Errors are those of positions: whoever commands says where fingertips should be, and a delayed command
    leads to where they should have been some steps ago, wherever the hand is by now.

    Args:
        hand: Which hand is commanded in every row.
        rows: Number of hands; nothing goes wrong in a row before its `begin`.
    """

    def __init__(self, hand: Hand, rows: int) -> None:
        self._hand = hand
        self._rows = [RowErrors(hand, NO_ERRORS) for _ in range(rows)]
        self._kept: Tensor | None = None
        self._left: Tensor | None = None

    def __len__(self) -> int:
        return len(self._rows)

    def begin(self, row: int, errors: CommandErrors, seeds: Sequence[Seed | np.random.Generator]) -> None:
        """Begin an episode in a row.

        Args:
            row: Of the batch.
            errors: What goes wrong.
            seeds: Of every error's random numbers, or its generator; then the person's if there is a level.
        """
        self._rows[row] = RowErrors(self._hand, errors, [np.random.default_rng(seed) for seed in seeds], row)

    def restart(self, mask: Tensor | None = None) -> None:
        """Begin another episode in the rows of `mask`, shape (batch,), or in all, with further numbers."""
        chosen = [True] * len(self) if mask is None else mask.tolist()
        for row, again in zip(self._rows, chosen, strict=True):
            if again:
                row.restart()

    @property
    def in_event(self) -> NDArray[np.bool_]:
        """Rows whose last command was one of an event; see `RowErrors.in_event`. Shape (batch,)."""
        return np.array([row.in_event for row in self._rows])

    @property
    def events(self) -> list[ErrorEvent]:
        """What happened in the running episodes, row by row."""
        return [event for row in self._rows for event in row.events]

    def squeeze(self, slipping: Sequence[bool]) -> NDArray[np.float64]:
        """Return how hard each row's person presses, in units of what is needed; 1 without a level.

        The factor of a squeeze that is part of the draft, before the person's scale changes that; call it
        once per step, before `delayed`.

        Args:
            slipping: Whether a row's object is seen to slip.
        """
        return np.array([row.squeeze(seen) for row, seen in zip(self._rows, slipping, strict=True)])

    def delayed(self, command: Tensor) -> Tensor:
        """Return each row's command as it was when the one that arrives now was given.

        Call it once per step, before `step`.

        Args:
            command: Positions of fingertips [m], or joint targets [rad]. Shape (batch, ...).
        """
        if not any(row.lag for row in self._rows):
            return command
        return torch.stack([row.delayed(value) for row, value in zip(self._rows, command, strict=True)])

    def step(
        self, draft: Tensor, tips: Tensor, loads: Tensor, inward: Tensor, *, held: bool = False
    ) -> Tensor:
        """Return the draft with the errors of this control step, delays apart. Shape as `draft`.

        Args:
            draft: Where the fingertips should be after 1, 2, ... steps, relative to `tips` [m]. Shape
                (batch, H, fingers, 3).
            tips: Measured fingertips [m]. Shape (batch, fingers, 3).
            loads: Normal force of each fingertip [N]. Shape (batch, fingers).
            inward: Contact normals into the object. Shape (batch, fingers, 3).
            held: Whether the later steps repeat the first, as a glove's do that knows no future: then its
                error is theirs too.
        """
        felt, normals = _array(loads), _array(inward)
        for k, row in enumerate(self._rows):
            row.advance(felt[k], normals[k])
        ahead = 1 if held else draft.shape[1]
        factors = np.array([row.factor for row in self._rows]).reshape(-1, 1, 1, 1)
        draft = effects.scaled(draft, _like(factors, draft))
        draft = effects.shaken(draft, _like(np.stack([row.offsets(ahead) for row in self._rows]), draft))
        return self._removed(self._stopped(draft, tips), tips)

    def _stopped(self, draft: Tensor, tips: Tensor) -> Tensor:
        """Return the draft of which still fingers stay where the last command before that wanted them."""
        still = np.stack([row.still for row in self._rows])
        struck = torch.as_tensor(still, device=draft.device)[..., None]
        wanted = tips + draft[:, 0]
        kept = tips if self._kept is None else self._kept
        self._kept = torch.where(struck, kept, wanted)
        return effects.replaced(draft, struck[:, None], (self._kept - tips)[:, None])

    def _removed(self, draft: Tensor, tips: Tensor) -> Tensor:
        """Return the draft of which removed fingers leave from where they were felt, and go on outward."""
        ages, way = np.zeros(tips.shape[:2], int), np.zeros(draft.shape)
        for k, row in enumerate(self._rows):
            for schedule in row.schedules:
                if schedule.active and schedule.error.family == "removal":
                    ages[k, schedule.finger] = schedule.age
                    steps = schedule.age + np.arange(draft.shape[1])
                    way[k, :, schedule.finger] = schedule.error.strength * steps[:, None] * schedule.outward
        age = torch.as_tensor(ages, device=draft.device)[..., None]
        self._left = tips if self._left is None else torch.where(age > 1, self._left, tips)
        left = (self._left - tips)[:, None] + _like(way, draft)
        return effects.replaced(draft, age[:, None] > 0, left)


def seeds_of(errors: CommandErrors, seed: Seed) -> list[Seed]:
    """Return the seeds of an episode's errors and person; none depends on what else goes wrong."""
    first = seed if isinstance(seed, tuple) else (seed,)
    salts = [error.row.salt for error in errors] + [LEVEL_SALT] * bool(errors.level)
    return [(*first, *salt) for salt in salts]


def _array(values: Tensor) -> NDArray[np.float64]:
    return values.detach().double().cpu().numpy()


def _like(values: NDArray[np.float64], like: Tensor) -> Tensor:
    return torch.as_tensor(values, dtype=like.dtype, device=like.device)
