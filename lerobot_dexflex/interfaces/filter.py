"""Smooth and bound fingertip displacements before executing them: the classical cure for a bad command."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.raw import RawInterface

SMOOTHING = 0.4
"""Weight of the newest displacement in the one-pole low-pass: a time constant of about two control steps."""
CLIP = 0.006
"""Largest displacement per axis and control step [m]: just above the fastest demonstrated motion, 5.1 mm, so
that a clean command passes."""


class FilterInterface(RawInterface):
    """One-pole low-pass, then a per-axis clip of the displacement, then raw. Satisfies `Interface`.

    Args:
        smoothing: Weight of the newest displacement, in (0, 1]; 1 does not smooth.
        clip: Largest displacement per axis and control step [m].

    Raises:
        DexFlexError: If one is out of its range.
    """

    name: str = "filter"

    def __init__(self, smoothing: float = SMOOTHING, clip: float = CLIP) -> None:
        super().__init__()
        if not 0 < smoothing <= 1:
            raise DexFlexError(f"`smoothing` must be in (0, 1]. Got {smoothing}.")
        if not clip > 0:
            raise DexFlexError(f"`clip` must be positive [m]. Got {clip}.")
        self._smoothing, self._clip = smoothing, clip
        self._average: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        if mask is None or self._average is None:
            self._average = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._average.device)
        # NaN marks a row without a past: its next displacement becomes its average.
        self._average = self._average.masked_fill(mask[:, None, None], torch.nan)

    def displacement(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the filtered displacement [m]. Shape (batch, 4, 3)."""
        newest = super().displacement(observation, draft)
        average = newest if self._average is None else self._average
        average = torch.where(average.isnan(), newest, average)
        self._average = average + self._smoothing * (newest - average)
        return self._average.clamp(-self._clip, self._clip)
