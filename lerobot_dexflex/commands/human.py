"""A person who leads a hand: traits that stay, and what goes wrong in an episode, step by step."""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.commands.levels import (
    DRIFT_TIME,
    HABIT,
    JITTER_TIME,
    TREMOR_CORRELATION,
    Level,
    Range,
)
from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]


class Person(NamedTuple):
    """What stays with a person from episode to episode."""

    delay: int
    """[control steps]."""
    scale: float
    """Factor of every motion."""
    squeeze: float
    """Tendency, in units of what is needed."""

    @classmethod
    def draw(cls, level: Level, rng: np.random.Generator) -> Self:
        """Draw a person; factors are as often halved as doubled."""
        delay = int(rng.integers(level.delay[0], level.delay[1] + 1))
        return cls(delay, _factor(rng, level.scale), _factor(rng, level.squeeze))


class Wander:
    """First-order autoregressive noise on every fingertip coordinate.

    Args:
        hand: Whose fingertips.
        rng: Source of randomness.
        size: Standard deviation [m].
        correlation: Of consecutive control steps.
    """

    def __init__(self, hand: Hand, rng: np.random.Generator, size: float, correlation: float) -> None:
        self._rng, self._size, self._correlation = rng, size, correlation
        self._value = rng.normal(size=(hand.n_fingers, 3))

    def step(self) -> Array:
        """Go on by a control step and return the offsets [m]. Shape (fingers, 3)."""
        fresh = np.sqrt(1 - self._correlation**2) * self._rng.normal(size=self._value.shape)
        self._value = self._correlation * self._value + fresh
        return self._size * self._value


class HumanErrors:
    """What a person of a level and the tracker do to one hand's commands.

    The errors are those of now: a draft's later steps have them, too, as nobody knows the errors to come.

    Args:
        hand: The hand that is led.
        level: Row of `LEVELS`.
        rng: Source of randomness, of the person and of all episodes.
    """

    def __init__(self, hand: Hand, level: Level, rng: np.random.Generator) -> None:
        self._hand, self._level, self._rng = hand, level, rng
        self.person = Person.draw(level, rng)
        self.restart()

    def restart(self) -> None:
        """Begin another episode of the same person."""
        level, rng = self._level, self._rng
        jitter, drift = (float(np.exp(-CONTROL_PERIOD / time)) for time in (JITTER_TIME, DRIFT_TIME))
        self._noises = [
            Wander(self._hand, rng, level.tremor, TREMOR_CORRELATION),
            Wander(self._hand, rng, level.jitter, jitter),
            Wander(self._hand, rng, level.drift, drift),
        ]
        self.offset = np.zeros((self._hand.n_fingers, 3))
        """Errors of the positions of this step [m]. Shape (fingers, 3)."""
        self.finger: int | None = None
        """That the tracker has lost; None while it sees all."""
        self.left = 0
        """Steps for which it stays lost, this one included."""
        self._until = self._steps(level.every)
        chosen = self.person.squeeze * np.exp(HABIT * rng.normal())
        self._squeeze = float(np.clip(chosen, *level.squeeze))
        # Drawn now and not at the slip: what happens to the object changes no other number.
        self._pace = abs(1.0 - self._squeeze) / self._steps(level.reaction)
        self._slipped = False

    def advance(self) -> bool:
        """Go on by a control step; returns whether a finger is lost with it."""
        self.offset = np.sum([noise.step() for noise in self._noises], axis=0)
        self.left = max(0, self.left - 1)
        self._until -= 1
        if self._until > 0:
            self.finger = self.finger if self.left else None
            return False
        self.finger, self.left = int(self._rng.integers(self._hand.n_fingers)), self._steps(self._level.lost)
        self._until = self._steps(self._level.every)
        return True

    def squeeze(self, slipping: bool) -> float:
        """Return how hard the person presses, in units of what is needed; called once per step.

        It is what arrives at the hand, whatever the person's scale, and stays as it was chosen until a slip
        is seen; then it goes to 1 at an even pace.

        Args:
            slipping: Whether the object is seen to slip.
        """
        self._slipped |= slipping
        if self._slipped:
            self._squeeze += float(np.clip(1.0 - self._squeeze, -self._pace, self._pace))
        return self._squeeze

    def _steps(self, seconds: Range) -> int:
        return round(float(self._rng.uniform(*seconds)) / CONTROL_PERIOD)


def _factor(rng: np.random.Generator, bounds: Range) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))
