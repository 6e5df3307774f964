"""Lay the numbers of a hand out as arrays, in the form that the compiled kinematics read.

All joints of the hand stand one after another, finger by finger, however many each finger has. A *turned*
frame of a link is its own frame, turned once and for all such that the joint turns about -z: the loops then
need no axes. A link whose axis is -z already keeps its frame to the last bit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hands.body import Quaternion, Vector3
from lerobot_dexflex.hands.finger import Finger

Array = NDArray[np.float64]


class Tables(NamedTuple):
    """A hand as `hand.kernels` reads it. Made once per hand: `Hand.tables`."""

    starts: NDArray[np.int64]
    """First joint of each finger and, at the end, the number of joints. Shape (fingers + 1,)."""
    widest: int
    """Largest number of joints of a finger."""
    lower: Array
    """Lower joint limits [rad]. Shape (joints,)."""
    upper: Array
    """Upper joint limits [rad]. Shape (joints,)."""
    positions: Array
    """Origin of each link in the turned frame of its parent [m]. Shape (joints, 3)."""
    rotations: Array
    """Turned frame of each link, at zero, in the turned frame of its parent. Shape (joints, 3, 3)."""
    ends: Array
    """Tip [m], pad centre [m] and inward pad normal in the turned distal frame. Shape (fingers, 3, 3)."""
    turned: NDArray[np.bool_]
    """Whether the turned frame of the distal link is another than its own. Shape (fingers,)."""
    turns: Array
    """Turned frame of the distal link in its own frame. Shape (fingers, 3, 3)."""


def tables_of(fingers: Sequence[Finger]) -> Tables:
    """Return the tables of a hand with these fingers."""
    counts = [len(finger.links) for finger in fingers]
    positions, rotations, ends, turns = [], [], [], []
    for finger in fingers:
        turn = np.eye(3)
        for link in finger.links:
            positions.append(_seen_from(turn, np.array(link.position, float)))
            rotation, before, turn = rotation_of(link.quaternion), turn, _turn_of(link.axis)
            rotations.append(_seen_from(before, rotation if _is_identity(turn) else rotation @ turn))
        inward = -rotation_of(finger.pad_quaternion)[:, 2]
        local = np.array([finger.tip_position, finger.pad_position, inward])
        ends.append(_seen_from(turn, local.T).T)
        turns.append(turn)
    limits = np.array([link.joint_range for finger in fingers for link in finger.links], float)
    return Tables(
        starts=np.cumsum([0, *counts]),
        widest=max(counts),
        lower=np.ascontiguousarray(limits[:, 0]),
        upper=np.ascontiguousarray(limits[:, 1]),
        positions=np.array(positions),
        rotations=np.array(rotations),
        ends=np.ascontiguousarray(ends),
        turned=np.array([not _is_identity(turn) for turn in turns]),
        turns=np.array(turns),
    )


def rotation_of(quaternion: Quaternion) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (w x y z), not necessarily normalised."""
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _turn_of(axis: Vector3) -> Array:
    """Return a rotation (3, 3) that takes -z to an axis; the identity for -z itself."""
    z = -np.array(axis, float)
    z /= np.linalg.norm(z)
    helper = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.7 else np.array([0.0, 1.0, 0.0])
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


def _is_identity(turn: Array) -> bool:
    return np.array_equal(turn, np.eye(3))


def _seen_from(turn: Array, value: Array) -> Array:
    """Express columns of a link's frame in its turned frame; unturned they keep their signs of zero."""
    return value if _is_identity(turn) else turn.T @ value
