"""Calibrate to a person: wait for an open hand that is held still, then fit it."""

from dataclasses import dataclass, field

import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.record import KEYPOINT_NAMES, ROBOT_TIPS, Array, Record
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
_FINGERS = ("index_finger", "middle_finger", "ring_finger")
_NEEDED = [k for k, name in enumerate(KEYPOINT_NAMES) if not name.startswith("pinky")]


@dataclass
class OpenHand:
    """Waits until the hand is open and still, record by record.

    Args:
        thumb_scale: See `Retargeting`.
    """

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
        if record is None or newest.stale or not record.tracked[_NEEDED].all():
            self._held = []
            return None
        if not self._held or _moved(self._held[0], record):
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
            _check_straight(mean.keypoints)
            found = calibrate(mean, self.thumb_scale)
            if found.residual > OPEN:
                raise DexFlexError(
                    f"That is no open hand, it fits to {1e3 * found.residual:.0f} mm only. Spread the thumb."
                )
        except DexFlexError as error:
            self.complaint = str(error)
            return None
        return found


def _moved(first: Record, record: Record) -> bool:
    apart = first.keypoints[ROBOT_TIPS] - record.keypoints[ROBOT_TIPS]
    return bool(np.linalg.norm(apart, axis=1).max() > STILL)


def _mean(records: list[Record]) -> Record:
    """Return a record of the mean keypoints, without a wrist."""
    keypoints = np.mean([record.keypoints for record in records], axis=0)
    nowhere = np.full((3, 3), np.nan)
    tracked = np.isfinite(keypoints).all(1)
    return Record(records[-1].t, nowhere[0], nowhere, keypoints, tracked, wrist_tracked=False)


def _check_straight(keypoints: Array) -> None:
    """Refuse bent fingers.

    Raises:
        DexFlexError: If one is bent.
    """
    for finger in _FINGERS:
        joints = keypoints[
            [KEYPOINT_NAMES.index(f"{finger}_{name}") for name in ("mcp", "pip", "dip", "tip")]
        ]
        length = np.linalg.norm(np.diff(joints, axis=0), axis=1).sum()
        if np.linalg.norm(joints[-1] - joints[0]) < STRAIGHT * length:
            raise DexFlexError(f"The {finger.replace('_', ' ')} is bent. Open the hand.")
