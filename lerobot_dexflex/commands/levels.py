"""How well people lead a hand with a glove or a tracker: one table of levels.

Measured by others:

- Finger tremor is about .03 mm with the arm supported, twice that with the hand held out, 4 to 5 times with
  the arm held out (Growdon et al. 2000, Electromyogr. Clin. Neurophysiol. 40(5)), at 8 to 12 Hz. At 20
  control steps per second such an oscillation changes its sign in nearly every step.
- Tracked hands jitter by .4 to .8 mm (Leap Motion Controller 2) or 1.3 to 2.2 mm (its predecessor; Sensors
  2025, 25(24), 7473).
- The Meta Quest 2 comes 45 ms late; its fingertips are off by 11 mm on average (Abdlkarim et al. 2024,
  Behavior Research Methods 56), most of it a constant that who watches the robot makes up for: our drift is
  what remains.

All other numbers are our choice: the ranges of delay, scale, squeeze and reaction, the losses, and every
correlation time.
"""

from typing import NamedTuple

Range = tuple[float, float]


class Level(NamedTuple):
    """How far people of one level are off. Sizes are standard deviations of every fingertip coordinate."""

    tremor: float
    """Of the fingers [m]."""
    jitter: float
    """Slow noise of hand and tracker [m], correlated over `JITTER_TIME`."""
    drift: float
    """Of each finger's calibration [m], correlated over `DRIFT_TIME`."""
    delay: tuple[int, int]
    """From the hand to the command [control steps], both ends included."""
    scale: Range
    """Factor of every motion; a hand of another size, a gain of the tracker."""
    squeeze: Range
    """Pressure in units of what is needed, chosen without feeling it."""
    reaction: Range
    """From the sight of a slip until the squeeze is right [s]."""
    lost: Range
    """Time for which the tracker loses a finger [s]."""
    every: Range
    """Time from one loss to the next [s]."""


LEVELS: dict[str, Level] = {
    "steady": Level(
        tremor=3e-5,
        jitter=4e-4,
        drift=5e-4,
        delay=(1, 1),
        scale=(0.95, 1.05),
        squeeze=(0.8, 1.25),
        reaction=(0.3, 0.4),
        lost=(0.2, 0.3),
        every=(8.0, 10.0),
    ),
    "typical": Level(
        tremor=6e-5,
        jitter=8e-4,
        drift=1e-3,
        delay=(1, 2),
        scale=(0.9, 1.1),
        squeeze=(0.65, 1.5),
        reaction=(0.3, 0.5),
        lost=(0.2, 0.4),
        every=(6.0, 9.0),
    ),
    "novice": Level(
        tremor=1.5e-4,
        jitter=2e-3,
        drift=2e-3,
        delay=(2, 3),
        scale=(0.8, 1.25),
        squeeze=(0.5, 2.0),
        reaction=(0.4, 0.6),
        lost=(0.3, 0.6),
        every=(5.0, 7.0),
    ),
}
"""Every level by name, from the best to the worst."""
JITTER_TIME, DRIFT_TIME = 0.3, 10.0
"""Correlation times [s]."""
TREMOR_CORRELATION = -0.7
"""Of consecutive control steps: most of the power lies above 8 Hz, near the 10 Hz that 20 Hz can show."""
HABIT = 0.1
"""Standard deviation of the logarithm of a person's squeeze from episode to episode."""
