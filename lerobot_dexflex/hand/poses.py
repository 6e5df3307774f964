"""Small algebra of poses: position [m] and unit quaternion (w x y z)."""

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def quaternion_matrix(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a unit quaternion (w x y z)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def pose_error(
    position: Array, quaternion: Array, goal: Array, goal_quaternion: Array
) -> tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two poses."""
    cosine = min(1.0, abs(float(quaternion @ goal_quaternion)))
    return float(np.linalg.norm(goal - position)), 2.0 * float(np.arccos(cosine))


def quaternion_product(first: Array, second: Array) -> Array:
    """Return the rotation `second`, then `first` (w x y z)."""
    product = np.empty(4)
    mujoco.mju_mulQuat(product, first, second)
    return product


def quaternion_of(rotation_vector: Array) -> Array:
    """Return the quaternion (w x y z) of a rotation vector [rad]."""
    angle = float(np.linalg.norm(rotation_vector))
    if angle < 1e-12:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) / angle * rotation_vector])


def rotation_between(start: Array, end: Array) -> Array:
    """Return the world-frame rotation vector [rad] (3,) that turns one orientation into another."""
    turn = quaternion_product(end, start * [1, -1, -1, -1])
    if turn[0] < 0:
        turn = -turn
    sine = float(np.linalg.norm(turn[1:]))
    return 2 * turn[1:] if sine < 1e-9 else turn[1:] / sine * 2 * np.arctan2(sine, turn[0])
