"""Lead a robot's fingertips with a human's: a similarity transform, found from one open hand."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lerobot_dexflex.conventions import FINGER_NAMES
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.streams.record import ROBOT_TIPS, Array, Record

OPEN_HAND = (*(0.0,) * 14, 1.0, 0.0)
"""Joints of the robot's open hand [rad]: fingers straight, the thumb as far forward as a person's. With a
straight one an average hand fits to 20 mm, with this one to 8 mm."""
_THUMB = FINGER_NAMES.index("thumb")
_FLAT = 0.05
"""Fingertips whose second extent is less than this share of the first lie in one line."""


@dataclass(frozen=True, eq=False)
class Retargeting:
    """How a human's fingertips become a robot's: scale * rotation @ tip + offset."""

    scale: float
    thumb_scale: float
    """Extra, of the thumb alone, from the wrist; 1 keeps what touches touching."""
    rotation: Array
    """From the wrist frame to the robot's palm frame. Shape (3, 3)."""
    offset: Array
    """Where the wrist is in the palm frame [m]. Shape (3,)."""
    residual: float
    """Root mean square of what the open hands leave unexplained per fingertip [m]."""

    def __call__(self, tips: Array) -> Array:
        """Return fingertips in the palm frame [m], of those in the wrist frame [m]; both of shape (4, 3)."""
        return self.scale * _stretched(tips, self.thumb_scale) @ self.rotation.T + self.offset


def calibrate(record: Record, thumb_scale: float = 1.0, joints: ArrayLike = OPEN_HAND) -> Retargeting:
    """Find the retargeting that lays an open human hand over the robot's, by least squares.

    Args:
        record: Of a flat, open hand with the thumb spread; of a left hand, mirrored.
        thumb_scale: See `Retargeting`.
        joints: The robot's open hand [rad]. Shape (16,).

    Raises:
        DexFlexError: If a fingertip is lost, they lie in one line, or the record is of the other hand.
    """
    if not record.tracked[ROBOT_TIPS].all():
        lost = [name for name, seen in zip(FINGER_NAMES, record.tracked[ROBOT_TIPS], strict=True) if not seen]
        raise DexFlexError(
            f"All four fingertips must be tracked. {', '.join(lost)} are lost: show the open hand."
        )
    if not thumb_scale > 0:
        raise DexFlexError(f"`thumb_scale` must be positive. Got {thumb_scale}.")
    human, robot = (
        _stretched(record.keypoints[ROBOT_TIPS], thumb_scale),
        fingertips(LEAP.tables, np.array(joints, float)),
    )
    retargeting = _similarity(human, robot, thumb_scale)
    if retargeting.rotation[2, 2] < 0:
        raise DexFlexError(
            "The palm would look out of the robot's back: this is a left hand. Read it with `mirror`."
        )
    return retargeting


def _similarity(human: Array, robot: Array, thumb_scale: float) -> Retargeting:
    """Return the least-squares similarity (Umeyama, TPAMI 1991, eq. 34 to 42) from human to robot, (4, 3)."""
    a, b = human - human.mean(0), robot - robot.mean(0)
    spread = np.linalg.svd(a, compute_uv=False)
    if spread[1] < _FLAT * spread[0] or spread[0] == 0:
        raise DexFlexError("The fingertips must not lie in one line. Spread the thumb.")
    U, D, Vt = np.linalg.svd(b.T @ a)
    S = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    rotation = U * S @ Vt
    scale = float((D * S).sum() / (a**2).sum())
    left = b - scale * a @ rotation.T
    offset = robot.mean(0) - scale * rotation @ human.mean(0)
    return Retargeting(scale, thumb_scale, rotation, offset, float(np.sqrt((left**2).sum(1).mean())))


def _stretched(tips: Array, thumb_scale: float) -> Array:
    factors = np.ones((len(FINGER_NAMES), 1))
    factors[_THUMB] = thumb_scale
    return tips * factors
