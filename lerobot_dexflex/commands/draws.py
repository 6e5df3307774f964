"""The random numbers of one hand's command errors: drawn on the CPU, the same on every device."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands.families import ONSET, REMOVAL_STEPS, CommandError, CommandErrors
from lerobot_dexflex.commands.human import HumanErrors
from lerobot_dexflex.commands.levels import LEVELS
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

MIN_LOAD = 0.05
"""A finger that carries less is not removed [N]: the hand holds nothing."""
LOST = "lost"
"""Name of the event in which a person's tracker loses a finger."""


class ErrorEvent(NamedTuple):
    """A stretch of an episode in which something went wrong with a hand's commands."""

    row: int
    """Of the batch."""
    family: str
    """Of the table, or `LOST`."""
    onset: int
    """First control step, counted from the start of the episode."""
    end: int
    """One past the last step."""
    finger: int | None
    """Index in `Hand.fingers`; None for all fingers."""


class EventSchedule:
    """When the events of one error begin and whom they strike.

    Args:
        hand: Whose fingers are struck.
        error: Of a family with an onset.
        rng: Source of randomness.
        until: Steps to the first event.
    """

    def __init__(self, hand: Hand, error: CommandError, rng: np.random.Generator, until: int) -> None:
        self._hand, self.error, self._rng, self._until = hand, error, rng, until
        self._left = 0
        self.finger: int | None = None
        self.outward = np.zeros(3)
        """Direction in which a removed finger leaves the object."""

    @property
    def active(self) -> bool:
        """Whether an event is going on."""
        return self._left > 0

    @property
    def age(self) -> int:
        """Steps of the event that is going on, this one included."""
        return self.error.steps - self._left + 1

    def advance(self, loads: Array, inward: Array) -> bool:
        """Go on by a control step; returns whether an event begins with it. Arguments as `RowErrors`'."""
        self._left = max(0, self._left - 1)
        self._until -= 1
        onset = self.error.row.onset
        if self._until > 0 or self.active or onset is None:
            return False
        self._until = int(self._rng.integers(*onset.next)) + self.error.steps - REMOVAL_STEPS
        if not self._strike(loads, inward):
            return False
        self._left = self.error.steps
        return True

    def _strike(self, loads: Array, inward: Array) -> bool:
        if self.error.family == "dropout":
            self.finger = int(self._rng.integers(self._hand.n_fingers))
        elif self.error.family == "removal":
            self.finger = int(np.argmax(loads))
            self.outward = -inward[self.finger]
            return bool(loads[self.finger] > MIN_LOAD)
        return True


class RowErrors:
    """The errors of one hand, step by step.

    Args:
        hand: Whose commands they are.
        errors: What goes wrong.
        generators: Source of randomness of every error, then of the person if there is a level.
        row: Of the batch, for the log.
    """

    def __init__(
        self,
        hand: Hand,
        errors: CommandErrors,
        generators: Sequence[np.random.Generator] = (),
        row: int = 0,
    ) -> None:
        self._hand, count = hand, len(errors.errors)
        self._errors, self._generators, self._row = errors, generators[:count], row
        self.human = HumanErrors(hand, LEVELS[errors.level], generators[count]) if errors.level else None
        strengths = {error.family: error.strength for error in errors}
        self.factor = strengths.get("scale", 1.0)
        self.lag = int(strengths.get("delay", 0))
        if self.human:
            self.factor *= self.human.person.scale
            self.lag += self.human.person.delay
        self._begin()

    def restart(self) -> None:
        """Begin another episode of the same person; the generators go on."""
        if self.human:
            self.human.restart()
        self._begin()

    def _begin(self) -> None:
        shape = self._hand.n_fingers, 3
        self.bias = np.zeros(shape)
        self.schedules: list[EventSchedule] = []
        self.drawn: list[Array] = []
        self._step, self._events = -1, list[ErrorEvent]()
        self._past: deque[Tensor] = deque(maxlen=self.lag + 1)
        for error, rng in zip(self._errors, self._generators, strict=True):
            # Drawn for every family, needed or not: so a seed goes on meaning the same episode.
            bias, until = rng.uniform(-1, 1, shape) * error.strength, int(rng.integers(*ONSET.first))
            if error.family == "bias":
                self.bias = bias
            if error.row.onset:
                self.schedules.append(EventSchedule(self._hand, error, rng, until))

    @property
    def events(self) -> list[ErrorEvent]:
        """Events until now; the end of one that is going on is the step after this one."""
        return [event._replace(end=min(event.end, self._step + 1)) for event in self._events]

    @property
    def in_event(self) -> bool:
        """Whether an event is going on: removal, freeze, dropout, or a lost finger."""
        lost = self.human is not None and self.human.finger is not None
        return lost or any(schedule.active for schedule in self.schedules)

    @property
    def still(self) -> NDArray[np.bool_]:
        """Fingers whose commands stand still in this step. Shape (fingers,)."""
        struck = np.zeros(self._hand.n_fingers, bool)
        if self.human and self.human.finger is not None:
            struck[self.human.finger] = True
        for schedule in self.schedules:
            if schedule.active and schedule.error.family in ("freeze", "dropout"):
                struck[slice(None) if schedule.finger is None else schedule.finger] = True
        return struck

    def squeeze(self, slipping: bool) -> float:
        """Return how hard to press before the errors, in units of what is needed; see `HumanErrors`."""
        if not self.human:
            return 1.0
        return self.human.squeeze(slipping) / self.human.person.scale

    def advance(self, loads: Array, inward: Array) -> None:
        """Go on by a control step.

        Args:
            loads: Normal force of each fingertip [N]. Shape (fingers,).
            inward: Contact normals into the object. Shape (fingers, 3).
        """
        self._step += 1
        if self.human and self.human.advance():
            end = self._step + self.human.left
            self._events.append(ErrorEvent(self._row, LOST, self._step, end, self.human.finger))
        for schedule in self.schedules:
            if schedule.advance(loads, inward):
                error, onset = schedule.error, self._step
                event = ErrorEvent(self._row, error.family, onset, onset + error.steps, schedule.finger)
                self._events.append(event)

    def delayed(self, now: Tensor) -> Tensor:
        """Return what was commanded `lag` steps ago, or the first command of the episode."""
        self._past.append(now)
        return self._past[0]

    def offsets(self, ahead: int) -> Array:
        """Return the errors of the positions of this step and the next ones [m]. Shape (ahead, fingers, 3).

        They belong to control steps: one that is planned twice has the same error in both plans.

        Args:
            ahead: Number of steps.
        """
        total = np.tile(self.bias if self.human is None else self.bias + self.human.offset, (ahead, 1, 1))
        for error, rng in zip(self._errors, self._generators, strict=True):
            if error.family != "noise":
                continue
            drawn, step, width = self.drawn, self._step, error.strength
            while len(drawn) < step + ahead:
                drawn.append(rng.uniform(-width, width, self.bias.shape))
            total = total + np.stack(drawn[step : step + ahead])
        return total
