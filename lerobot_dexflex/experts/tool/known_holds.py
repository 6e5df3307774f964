"""Holds that were found once, by hand and by search, and that results are of; others are searched for."""

from collections.abc import Callable
from functools import cache

import numpy as np

from lerobot_dexflex.experts.tool.hold_search import find_holds
from lerobot_dexflex.experts.tool.holds import BarHold, DriverHold, Habit, Holds
from lerobot_dexflex.hands import Hand

_IDLE = np.array((0.3, 0.0, 0.3, 0.3) * 3 + (1.6, 0.2, 0.8, -0.2))
"""Fingers that take no part are stretched out."""
_ON_BAR = np.array(
    (
        *(1.519, 0.004, 0.368, -0.316),
        *(1.518, -0.024, 0.367, -0.315),
        *(1.524, -0.053, 0.354, -0.307),
        *(1.755, 0.002, 0.386, -0.385),
    )
)
"""Flat on a bar of 13 mm half width."""
_ON_PITCHER = np.array(
    (
        *(1.658, -0.040, 0.283, -0.286),
        *(1.656, -0.045, 0.285, -0.286),
        *(1.657, -0.049, 0.284, -0.286),
        *(1.929, -0.027, 0.326, -0.399),
    )
)
"""Flat on a bar of 20 mm width."""
_BESIDE = (0.6, -0.3, 0.3, 0.3)
_PAIR = (1.066, -0.533, 0.917, -0.316, 1.752, -0.630, -0.457, 0.194)
_OPPOSITE = (1.369, -0.068, 0.912, -0.924)


def _leap(hand: Hand) -> Holds:
    frame = np.eye(3)
    bar = BarHold(
        hand,
        frame,
        centre=np.array([-0.0405, -0.0353, -0.1401]),
        touch=_ON_BAR,
        idle=_IDLE,
        along=np.array([0.043, 0.0, -0.043, 0.012]),
    )
    return Holds(
        frame,
        bar,
        pitcher=bar._replace(
            centre=np.array([-0.0495, -0.0335, -0.1372]),
            touch=_ON_PITCHER,
            along=np.array([0.045, 0.0, -0.045, -0.010]),
            turn=0.081,
        ),
        driver=DriverHold(
            bar._replace(
                centre=np.array([-0.0405, -0.0353, -0.1301]), along=np.array([0.043, 0.0, -0.043, 0.018])
            ),
            around=np.array([0.175, 0.175, 0.175, -0.375]),
            stroke=1.4,
        ),
        habits=(
            Habit(
                hand,
                frame,
                (0, 1, 3),
                np.array([-0.0230, 0.0242, -0.1247]),
                np.array((*_PAIR, *_BESIDE, *_OPPOSITE)),
                around=np.array([0.29, -0.155, 0.0, 0.069]),
                beside=np.array([-0.0105, 0.0105, 0.0, 0.0]),
                shift=-0.03,
            ),
            Habit(
                hand,
                frame,
                (1, 2, 3),
                np.array([-0.0230, -0.0212, -0.1247]),
                np.array((*_BESIDE, *_PAIR, *_OPPOSITE)),
                around=np.array([0.0, 0.29, -0.155, 0.069]),
                beside=np.array([0.0, -0.0105, 0.0105, 0.0]),
                shift=-0.03,
            ),
        ),
    )


_KNOWN: dict[str, Callable[[Hand], Holds]] = {"leap": _leap}


@cache
def holds_of(hand: Hand) -> Holds:
    """Return how a hand holds tools: as it is known, or as a search finds it."""
    return _KNOWN.get(hand.name, find_holds)(hand)
