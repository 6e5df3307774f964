"""Bad commands with breaks: corrupted stretches bring the hand off its way, clean ones show the way back."""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.commands.corruption import Corruption
from lerobot_dexflex.experts.reach.sensing import HandState

Array = NDArray[np.float64]

_CLEAN_SHARE = 0.15
_STRETCH = (6, 25)
"""Control steps of a stretch, the upper end excluded."""
_STRENGTHS = {
    "noise": (0.0005, 0.004),
    "scale": (0.4, 1.6),
    "delay": (1, 5),
    "removal": (0.001, 0.004),
    "bias": (0.0003, 0.0015),
}
"""Range of every family: [m], [1], [control steps], [m] per step, [m] per step."""


def sample_corruption(rng: np.random.Generator, clean_share: float = _CLEAN_SHARE) -> Corruption:
    """Draw a family and a strength; a share stays clean."""
    if rng.random() < clean_share:
        return Corruption()
    family = str(rng.choice(list(_STRENGTHS)))
    low, high = _STRENGTHS[family]
    strength = float(rng.integers(low, high + 1)) if family == "delay" else float(rng.uniform(low, high))
    return Corruption(family, strength)


class Distortion:
    """Corrupt an operator's displacements and say when they are to be executed.

    Args:
        corruption: What happens to the commands.
        rng: Source of randomness.
    """

    def __init__(self, corruption: Corruption, rng: np.random.Generator) -> None:
        self.corruption = corruption
        self._stream, self._rng = corruption.stream(rng), rng
        self._active, self._left = False, int(rng.integers(*_STRETCH))

    def step(self, label: Array, now: HandState) -> tuple[Array, bool]:
        """Return the corrupted displacement [m] (4, 3) and whether it, not the label, is executed."""
        if self._left == 0:
            self._active, self._left = not self._active, int(self._rng.integers(*_STRETCH))
        self._left -= 1
        draft = self._stream.step(label, now.loads, now.inward)
        return draft, self._active
