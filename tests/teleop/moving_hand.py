"""A synthetic hand that moves: records, and a source that sends them at a rate, with pauses.

Nothing here calls the code under test.
"""

import numpy as np
from synthetic_hand import HAND

from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.streams.record import Record
from lerobot_dexflex.streams.source import Newest

START = np.array((0.0, -0.35, 0.0, 0.95, 0.0, 1.3, np.pi / 2, *LEAP.relaxed_joints))
"""A robot over a table, palm down."""
TIPS = [8, 12, 16, 4]
"""Keypoints that lead the fingers of LEAP."""
FORWARD = np.eye(3)
"""Fingers to the world's +x, back of the hand up."""


def bent(angle):
    """Return the keypoints of a hand whose four fingers bend by an angle [rad] at each of their joints."""
    hand = HAND.copy()
    for knuckle in (5, 9, 13, 17):
        for joint in range(knuckle, knuckle + 3):
            arm = hand[joint + 1 : knuckle + 4] - hand[joint]
            x = np.cos(angle) * arm[:, 0] + np.sin(angle) * arm[:, 2]
            z = np.cos(angle) * arm[:, 2] - np.sin(angle) * arm[:, 0]
            hand[joint + 1 : knuckle + 4] = hand[joint] + np.stack([x, arm[:, 1], z], axis=1)
    return hand


def turned(angle):
    """Return the rotation about the world's z by an angle [rad]."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def record(t, keypoints=HAND, place=(0.0, 0.0, 1.0), turn=FORWARD, lost=(), wrist=True):
    """Return a record of which the keypoints `lost` are not tracked."""
    tracked = ~np.isin(np.arange(21), lost)
    return Record(t, np.array(place), np.array(turn), np.array(keypoints), tracked, wrist)


class MovingHand:
    """Satisfies `Source`, like a receiver: stale 100 ms after the look that found the last record.

    Args:
        at: Returns the record of a time [s], or None if none is sent then.
        rate: Records per second.
    """

    def __init__(self, at, rate=100.0):
        self._at, self._rate = at, rate
        self._sent, self._came, self._record = -1, float("-inf"), None

    def newest(self, now):
        # A clock that adds up ticks is a little short of them.
        last = int(now * self._rate + 1e-6)
        for k in range(self._sent + 1, last + 1):
            found = self._at(k / self._rate)
            if found is not None:
                self._record, self._came = found, now
        self._sent = last
        return Newest(self._record, now - self._came > 0.1)
