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
