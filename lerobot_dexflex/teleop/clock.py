"""The two rates of live operation, on a clock that tests and fast runs replace."""

import time
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from lerobot_dexflex.conventions import CONTROL_PERIOD

TICK = 0.02
"""Time between two looks at the stream, each with a step of the inverse kinematics [s]: 50 Hz."""
_SAME = 1e-6
"""Times that are nearer are one [s]: sums of periods differ in their last bits."""


class Clock(Protocol):
    """Tells the time and lets it pass."""

    def now(self) -> float:
        """Return the time [s]; only differences mean something, and it never goes back."""
        ...

    def wait(self, until: float) -> None:
        """Return at a time [s], or at once if that has passed."""
        ...


class SystemClock:
    """The machine's. Satisfies `Clock`."""

    def now(self) -> float:
        """Return the time [s]."""
        return time.monotonic()

    def wait(self, until: float) -> None:
        """Return at a time [s]."""
        if (left := until - time.monotonic()) > 0:
            time.sleep(left)


class SteppedClock:
    """Time passes by waiting only, as fast as the machine can. Satisfies `Clock`."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """Return the time [s]."""
        return self._now

    def wait(self, until: float) -> None:
        """Go on to a time [s]."""
        self._now = max(self._now, until)


class Beat(NamedTuple):
    """One moment at which something is due."""

    now: float
    """[s]."""
    control: bool
    """Whether a control step is due, after the tick that always is."""
    late: float
    """How long ago it was due [s]."""


def beats(clock: Clock) -> Iterator[Beat]:
    """Yield ticks at 50 Hz and control steps at 20 Hz, for ever; what was missed is left out.

    A control step comes after a tick of the same moment, so it knows the newest. Who is slow gets fewer
    beats, never a burst of late ones.
    """
    tick = control = clock.now()
    while True:
        due = min(tick, control)
        clock.wait(due)
        now = max(clock.now(), due)
        step = control <= now + _SAME
        yield Beat(now, step, now - due)
        tick = _following(tick, TICK, now)
        if step:
            control = _following(control, CONTROL_PERIOD, now)


def _following(due: float, period: float, now: float) -> float:
    """Return when something is due again: in its rhythm, or, if that has passed, a period from now."""
    if due > now + _SAME:
        return due
    return due + period if due + period > now + _SAME else now + period
