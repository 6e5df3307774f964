"""The way of a finger to a new place on the object: lift, swing, place."""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.fingers import FingerStates, Mode

Array = NDArray[np.float64]

LIFT_STEPS, LIFT_HEIGHT = 8, 0.018
"""A lifted finger leaves the object so far [m] in so many control steps."""
SWING_SPEED, SWING_STEPS, APPROACH = 0.006, 30, 0.012
"""Speed of a swing to above the new place [m] per step, its longest duration, and its end above it [m]."""
PLACE_SPEED, PRESS, PLACE_STEPS = 0.003, 0.004, 14
"""Speed of the placing [m] per step, how deep it may push [m] and how long it may take."""


def path_step(
    fingers: FingerStates, finger: int, free: Array, mode: int, timer: int
) -> tuple[Array, int, int]:
    """Return where a lifted tip is next in the object's frame [m], (3,), its mode and timer after that.

    Args:
        fingers: Where it comes from and goes to.
        finger: Index of the finger.
        free: Where its tip has got to, in the object's frame [m]. Shape (3,).
        mode: `Mode` above `HOLD`.
        timer: Steps in this mode, this one included.
    """
    goal, inward = fingers.next_anchor[finger], fingers.next_inward[finger]
    if mode == Mode.LIFT:
        lift = LIFT_HEIGHT * min(1.0, timer / LIFT_STEPS)
        local, done = fingers.anchor[finger] - lift * fingers.inward[finger], timer >= LIFT_STEPS
    elif mode == Mode.SWING:
        way = goal - APPROACH * inward - free
        local = free + shortened(way, SWING_SPEED)
        done = timer >= SWING_STEPS or bool(np.linalg.norm(way) <= SWING_SPEED)
    else:
        local, done = goal + min(PRESS, -APPROACH + PLACE_SPEED * timer) * inward, False
    return local, mode + done, 0 if done else timer


def shortened(vector: Array, limit: float) -> Array:
    """Return the vector, or one of length `limit` in its direction if it is longer."""
    length = float(np.linalg.norm(vector))
    return vector if length <= limit else vector * (limit / length)
