"""Lead a robot's fingertips with a human's: a similarity transform, found from one open hand."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kernels import fingertips, frames
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.streams.record import Array, Record, leading_tips

_FLAT = 0.05
"""Fingertips whose second extent is less than this share of the first lie in one line."""


@dataclass(frozen=True, eq=False)
class Retargeting:
    """How a human's fingertips become a robot's: scale * rotation @ tip + offset."""

    hand: Hand
    """The robot's."""
    scale: float
    thumb_scale: float
    """Extra, of the fingers that oppose alone, from the wrist; 1 keeps what touches touching."""
    rotation: Array
    """From the wrist frame to the robot's palm frame. Shape (3, 3)."""
    offset: Array
    """Where the wrist is in the palm frame [m]. Shape (3,)."""
    residual: float
    """Root mean square of what the open hands leave unexplained per fingertip [m]."""

    def __call__(self, tips: Array) -> Array:
        """Return fingertips in the palm frame [m], of those in the wrist frame [m]; both (fingers, 3)."""
        return self.scale * _stretched(self.hand, tips, self.thumb_scale) @ self.rotation.T + self.offset


def calibrate(
    hand: Hand, record: Record, thumb_scale: float = 1.0, joints: ArrayLike | None = None
) -> Retargeting:
    """Find the retargeting that lays an open human hand over the robot's, by least squares.

    Args:
        hand: The robot's.
        record: Of a flat, open hand with the thumb spread; of a left hand, mirrored.
        thumb_scale: See `Retargeting`.
        joints: The robot's open hand [rad]; None means `hand.open_joints`. Shape (joints,).

    Raises:
        DexFlexError: If a fingertip is lost, they lie in one line, or the record is of the other hand.
    """
    leading = leading_tips(hand)
    seen = record.tracked[leading]
    if not seen.all():
        lost = [name for name, tracked in zip(hand.finger_names, seen, strict=True) if not tracked]
        raise DexFlexError(
            f"The fingertips of {', '.join(hand.finger_names)} must be tracked. {', '.join(lost)} are lost: "
            "show the open hand."
        )
    if not thumb_scale > 0:
        raise DexFlexError(f"`thumb_scale` must be positive. Got {thumb_scale}.")
    human = _stretched(hand, record.keypoints[leading], thumb_scale)
    robot = np.array(hand.open_joints if joints is None else joints, float)
    retargeting = _similarity(hand, human, robot, thumb_scale)
    if retargeting.rotation[:, 2] @ _back(hand) < 0:
        raise DexFlexError(
            "The palm would look out of the robot's back: this is a left hand. Read it with `mirror`."
        )
    return retargeting


def _similarity(hand: Hand, human: Array, joints: Array, thumb_scale: float) -> Retargeting:
    """Return the least-squares similarity (Umeyama, TPAMI 1991, eq. 34 to 42) from human (fingers, 3)."""
    robot = fingertips(hand.tables, joints)
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
    residual = float(np.sqrt((left**2).sum(1).mean()))
    return Retargeting(hand, scale, thumb_scale, rotation, offset, residual)


def _stretched(hand: Hand, tips: Array, thumb_scale: float) -> Array:
    factors = np.ones((hand.n_fingers, 1))
    factors[list(hand.opposing_fingers)] = thumb_scale
    return tips * factors


def _back(hand: Hand) -> Array:
    """Return what looks out of the back of an open hand, palm frame, as z of `wrist_frame`. Shape (3,)."""
    joints = np.array(hand.open_joints)
    knuckles, tips = frames(hand.tables, joints)[0][:, 0], fingertips(hand.tables, joints)
    forward = (tips - knuckles)[list(hand.opposed_fingers)].mean(0)
    return np.cross(forward, hand.finger_order)
