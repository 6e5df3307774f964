"""Degrade a stream of fingertip displacements: noise, scaling, delay, support-finger removal, bias.

Sources: paper section 4.2 and design section 9. All numbers are per control step of 50 ms.
"""

from collections import deque
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError

Array = NDArray[np.float64]

_UNITS = {
    "clean": (),
    "noise": ("mm", 1e-3),
    "scale": ("", 1.0),
    "delay": ("", 1.0),
    "removal": ("mm", 1e-3),
    "bias": ("mm", 1e-3),
}
FAMILIES = tuple(_UNITS)
EVENT_STEPS = 8
"""Length of a removal: as long as the operator's own lifts."""
_FIRST_EVENT, _NEXT_EVENT = (8, 20), (17, 33)
_MIN_LOAD = 0.05


@dataclass(frozen=True)
class Corruption:
    """One kind of degradation and its strength.

    Raises:
        DexFlexError: If the family is unknown or the strength makes no sense.
    """

    family: str = "clean"
    """`clean`; `noise`: uniform in +-strength [m], new in every step; `scale`: times strength; `delay`: by
    strength steps; `removal`: the most loaded finger leaves the object by strength [m] per step for 8
    steps, about every 25 steps; `bias`: a constant uniform offset within +-strength [m]."""
    strength: float = 0.0

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise DexFlexError(f"Unknown corruption {self.family!r}. Valid: {', '.join(FAMILIES)}.")
        whole = self.family != "delay" or float(self.strength).is_integer()
        if not (np.isfinite(self.strength) and self.strength >= 0 and whole):
            raise DexFlexError(
                f"The strength of {self.family!r} must be 0 or more (m per step, a factor, or whole steps). "
                f"Got {self.strength}."
            )

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the corruption with this name, e.g. `clean`, `noise_2mm`, `scale_1.5`, `delay_2`.

        Raises:
            DexFlexError: If the name is none.
        """
        family, _, number = name.partition("_")
        unit = _UNITS.get(family, ())
        try:
            return cls(family, float(number.removesuffix(unit[0])) * unit[1] if unit else 0.0)
        except ValueError as error:
            raise DexFlexError(
                f"{name!r} is no corruption. Valid: clean, noise_<mm>mm, scale_<factor>, delay_<steps>, "
                "removal_<mm>mm, bias_<mm>mm."
            ) from error

    @property
    def name(self) -> str:
        """Name for tables; `parse` reads it."""
        unit = _UNITS[self.family]
        return f"{self.family}_{round(self.strength / unit[1], 6):g}{unit[0]}" if unit else self.family

    def stream(self, rng: np.random.Generator) -> "CommandStream":
        """Begin the stream of one episode."""
        return CommandStream(self, rng)


class CommandStream:
    """Corrupted commands of one episode; the random numbers do not depend on what the hand does."""

    def __init__(self, corruption: Corruption, rng: np.random.Generator) -> None:
        self._corruption, self._rng = corruption, rng
        self._past: deque[Array] = deque(maxlen=int(corruption.strength) + 1 if self._is("delay") else 1)
        self._bias = rng.uniform(-1, 1, (4, 3)) * corruption.strength
        self._until_event = int(rng.integers(*_FIRST_EVENT))
        self._event_steps = 0
        self._finger: int | None = None
        self._outward = np.zeros(3)

    @property
    def in_event(self) -> bool:
        """Whether the last command was one of a removal."""
        return self._event_steps > 0

    def step(self, clean: Array, loads: Array, inward: Array) -> Array:
        """Return the corrupted displacement [m] (4, 3).

        Args:
            clean: What the operator commands [m]. Shape (4, 3).
            loads: Normal force of each fingertip [N]. Shape (4,).
            inward: Contact normals into the object. Shape (4, 3).
        """
        strength = self._corruption.strength
        if self._is("noise"):
            return clean + self._rng.uniform(-strength, strength, (4, 3))
        if self._is("scale"):
            return strength * clean
        if self._is("bias"):
            return clean + self._bias
        if self._is("delay"):
            self._past.append(clean)
            return self._past[0].copy()
        if self._is("removal"):
            self._schedule(loads, inward)
            if self._finger is not None and self.in_event:
                corrupted = clean.copy()
                corrupted[self._finger] = strength * self._outward
                return corrupted
        return clean.copy()

    def _is(self, family: str) -> bool:
        return self._corruption.family == family

    def _schedule(self, loads: Array, inward: Array) -> None:
        if self._event_steps:
            self._event_steps = (self._event_steps + 1) % (EVENT_STEPS + 1)
        self._until_event -= 1
        if self._until_event > 0 or self._event_steps:
            return
        self._until_event = int(self._rng.integers(*_NEXT_EVENT))
        finger = int(np.argmax(loads))
        if loads[finger] > _MIN_LOAD:
            self._finger, self._outward, self._event_steps = finger, -inward[finger], 1
