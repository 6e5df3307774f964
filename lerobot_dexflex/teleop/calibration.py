"""Calibrate to a person: wait for an open hand that is held still, then fit it."""

from dataclasses import dataclass, field

import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.streams.record import HUMAN_TIPS, Array, Record, leading_tips
from lerobot_dexflex.streams.retarget import Retargeting, calibrate
from lerobot_dexflex.streams.source import Newest

HELD = 1.0
"""How long the hand must be still [s]."""
STILL = 0.01
"""Farthest that a fingertip may be from where it was first [m]."""
STRAIGHT = 0.95
"""Least distance from a finger's knuckle to its tip, in lengths of the finger."""
OPEN = 0.015
"""Largest residual of an open hand [m]; an average one has 8 mm, one whose thumb lies at the palm 25 mm."""
_JOINTS = 4
"""Keypoints of a person's finger, from the knuckle to the tip."""


@dataclass
class OpenHand:
    """Waits until the hand is open and still, record by record.

    Args:
        hand: The robot's, whose fingers those of the person lead.
        thumb_scale: See `Retargeting`.
    """

    hand: Hand
    thumb_scale: float = 1.0
    complaint: str = ""
    """What the operator should change, if the last still hand was not open."""
    _held: list[Record] = field(default_factory=list)
    _since: float = 0.0

    def look(self, newest: Newest, now: float) -> Retargeting | None:
        """Return the retargeting as soon as there is one.

        Args:
            newest: Of the source.
            now: The caller's clock [s].
        """
        record = newest.record
        if record is None or newest.stale or not record.tracked[self._needed].all():
            self._held = []
            return None
        if not self._held or self._moved(record):
            self._held, self._since = [record], now
        elif record is not self._held[-1]:
            self._held.append(record)
        if now - self._since < HELD:
            return None
        return self._fit(now)

    def _fit(self, now: float) -> Retargeting | None:
        mean = _mean(self._held)
        self._held, self._since = [], now
        try:
            self._check_straight(mean.keypoints)
            found = calibrate(self.hand, mean, self.thumb_scale)
            if found.residual > OPEN:
                raise DexFlexError(
                    f"That is no open hand, it fits to {1e3 * found.residual:.0f} mm only. Spread the thumb."
                )
        except DexFlexError as error:
            self.complaint = str(error)
            return None
        return found

    @property
    def _needed(self) -> list[int]:
        """Keypoints of the wrist and of the fingers that lead."""
        return [0, *(k for name in self.hand.finger_names for k in _keypoints(name))]

    def _moved(self, record: Record) -> bool:
        tips = leading_tips(self.hand)
        apart = self._held[0].keypoints[tips] - record.keypoints[tips]
        return bool(np.linalg.norm(apart, axis=1).max() > STILL)

    def _check_straight(self, keypoints: Array) -> None:
        """Refuse bent fingers, those that oppose apart.

        Raises:
            DexFlexError: If one is bent.
        """
        for name in (self.hand.finger_names[k] for k in self.hand.opposed_fingers):
            joints = keypoints[_keypoints(name)]
            length = np.linalg.norm(np.diff(joints, axis=0), axis=1).sum()
            if np.linalg.norm(joints[-1] - joints[0]) < STRAIGHT * length:
                raise DexFlexError(f"The {name} finger is bent. Open the hand.")


def _keypoints(finger: str) -> list[int]:
    """Return the keypoints of a person's finger, from the knuckle to the tip."""
    tip = HUMAN_TIPS[finger]
    return list(range(tip - _JOINTS + 1, tip + 1))


def _mean(records: list[Record]) -> Record:
    """Return a record of the mean keypoints, without a wrist."""
    keypoints = np.mean([record.keypoints for record in records], axis=0)
    nowhere = np.full((3, 3), np.nan)
    tracked = np.isfinite(keypoints).all(1)
    return Record(records[-1].t, nowhere[0], nowhere, keypoints, tracked, wrist_tracked=False)
