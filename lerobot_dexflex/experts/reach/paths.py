"""Where fingers go that do not carry: lifted ones to new places, lost ones back, parked ones nowhere."""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.fingers import FingerStates, Mode
from lerobot_dexflex.experts.reach.sensing import HandState

Array = NDArray[np.float64]

LIFT_STEPS, LIFT_HEIGHT = 8, 0.018
"""A lifted finger leaves the object so far [m] in so many control steps."""
SWING_SPEED, SWING_STEPS, APPROACH = 0.006, 30, 0.012
"""Speed of a swing to above the new place [m] per step, its longest duration, and its end above it [m]."""
PLACE_SPEED, PRESS, PLACE_STEPS = 0.003, 0.004, 14
"""Speed of the placing [m] per step, how deep it may push [m] and how long it may take."""
PARK_HEIGHT = 0.015
"""A finger that found nothing where it was placed is parked so far from there [m]."""
_RETURN, _RETURN_DEPTH = 0.002, 0.006
"""A finger that lost its load goes back by so much [m] per step, until it would be so deep [m]."""


def destination(fingers: FingerStates, now: HandState, finger: int) -> tuple[Array, float]:
    """Return where a tip that does not carry is to be next [m] (3,), and how fast it may go [m] per step."""
    if fingers.mode[finger] == Mode.PARKED:
        return fingers.park[finger], SWING_SPEED
    if fingers.mode[finger] == Mode.HOLD:
        deep = _RETURN_DEPTH * (fingers.inward @ now.rotation.T)[finger]
        return now.position + now.rotation @ fingers.anchor[finger] + deep, _RETURN
    return now.position + now.rotation @ fingers.free[finger], SWING_SPEED


def follow_paths(fingers: FingerStates, now: HandState) -> None:
    """Bring lifted fingers a step further on their paths."""
    for k in np.flatnonzero(fingers.mode > 0):
        fingers.free[k], fingers.mode[k], fingers.timer[k] = next_on_path(
            fingers, k, fingers.free[k], int(fingers.mode[k]), int(fingers.timer[k]) + 1
        )
        if fingers.mode[k] == Mode.PLACE and fingers.timer[k] > PLACE_STEPS:
            fingers.mode[k] = Mode.PARKED
            fingers.park[k] = now.tips[k] - PARK_HEIGHT * now.rotation @ fingers.next_inward[k]


def next_on_path(
    fingers: FingerStates, finger: int, free: Array, mode: int, timer: int
) -> tuple[Array, int, int]:
    """Return where a lifted tip is next in the object's frame [m], its mode and timer after that.

    Args:
        fingers: From where and to where it goes.
        finger: Index of the finger.
        free: Where it is [m]. Shape (3,).
        mode: Its mode.
        timer: Steps in this mode, the coming one included.
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
