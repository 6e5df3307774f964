"""Notice fingers whose touch cannot be trusted, before a network believes it."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.conventions import TACTILE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.touch import TouchConfig
from lerobot_dexflex.hands import Hand

TOUCH_HEALTH = ("ok", "missing", "frozen", "saturated")
"""What a finger's touch can be; `TouchReading.health` holds indices into it."""
FROZEN_STEPS = 5
"""A finger that reports the same non-zero taxels, bit for bit, this often in a row is frozen [control step]:
while it touches something, a live sensor has noise. All zero is what a live finger in the air reports."""
SATURATED_TAXELS = 15
"""A finger with so many of its taxels at full scale would carry 15 N or more: no hand presses so."""

_OK, _MISSING, _FROZEN, _SATURATED = range(len(TOUCH_HEALTH))


class TouchReading(NamedTuple):
    """Taxels that are safe to compute with."""

    tactile: Tensor
    """Taxel forces [N], finite; of a finger that is not well the last good ones.
    Shape (batch, fingers x taxels)."""
    health: Tensor
    """Index into `TOUCH_HEALTH` per finger. Shape (batch, fingers)."""

    @property
    def missing(self) -> Tensor:
        """True for fingers whose touch must not be used. Shape (batch, fingers)."""
        return self.health != _OK


class TouchWatch:
    """Judge every finger's touch, row by row.

    A bad reading is replaced by the finger's last good one, because zeros would tell of a lost contact when
    the networks look back.

    Args:
        hand: Whose fingers.
        frozen_steps: See `FROZEN_STEPS`.
        full_scale: Largest force that a taxel reports [N].
    """

    def __init__(
        self,
        hand: Hand,
        frozen_steps: int = FROZEN_STEPS,
        full_scale: float = TouchConfig().saturation,
    ) -> None:
        self.hand = hand
        self._frozen_steps, self._full_scale = frozen_steps, full_scale
        self._last: Tensor | None = None
        self._good: Tensor | None = None
        self._repeats: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the past of the rows in `mask`, shape (batch,), or of all."""
        if mask is None or self._last is None or self._good is None or self._repeats is None:
            self._last = self._good = self._repeats = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._last.device)
        self._last, self._good = (t.masked_fill(mask[:, None, None], 0.0) for t in (self._last, self._good))
        self._repeats = self._repeats.masked_fill(mask[:, None], 0)

    def look(self, observation: Mapping[str, Tensor], rows: int) -> TouchReading:
        """Judge this step's touch; call it once per control step.

        Args:
            observation: May hold `observation.tactile` [N], shape (rows, fingers x taxels); without it the
                touch of every finger is missing.
            rows: Number of hands.
        """
        taxels = checked_taxels(self.hand, observation, rows)
        if taxels is None:
            shape, like = (rows, *_shape_of(self.hand)), next(iter(observation.values()))
            taxels = torch.full(shape, torch.nan, device=like.device)
        if self._last is None or self._good is None or self._repeats is None:
            self._last = self._good = torch.zeros_like(taxels)
            self._repeats = torch.zeros(taxels.shape[:2], dtype=torch.int64, device=taxels.device)
        same = (taxels == self._last).all(-1) & (taxels != 0).any(-1)
        self._repeats = torch.where(same, self._repeats + 1, torch.zeros_like(self._repeats))
        self._last = taxels
        finite = torch.isfinite(taxels).all(-1)
        frozen = self._repeats + 1 >= self._frozen_steps
        saturated = (taxels >= self._full_scale).sum(-1) >= SATURATED_TAXELS
        health = torch.full_like(self._repeats, _OK)
        for index, sick in ((_FROZEN, frozen), (_SATURATED, saturated), (_MISSING, ~finite)):
            health = torch.where(sick, index, health)
        self._good = torch.where((health == _OK)[..., None], taxels, self._good)
        return TouchReading(self._good.flatten(1), health)


def checked_taxels(hand: Hand, observation: Mapping[str, Tensor], rows: int) -> Tensor | None:
    """Return the taxels as (rows, fingers, taxels), which may hold NaN, or None without the key.

    Raises:
        DexFlexError: If they have another shape.
    """
    if TACTILE not in observation:
        return None
    taxels, (fingers, each) = observation[TACTILE], _shape_of(hand)
    if tuple(taxels.shape) != (rows, fingers * each):
        grid = " x ".join(map(str, hand.taxels))
        raise DexFlexError(
            f"'{TACTILE}' must have shape ({rows}, {fingers * each}): {grid} taxels [N] of each of the "
            f"{fingers} fingers of '{hand.name}'. Got {tuple(taxels.shape)}. Leave the key out if there is "
            "no touch."
        )
    return taxels.float().unflatten(1, (fingers, each))


def _shape_of(hand: Hand) -> tuple[int, int]:
    """Return the number of fingers, and of taxels on each."""
    return hand.n_fingers, math.prod(hand.taxels)
