"""The hand's kinematics and contact statics for one hand, compiled: experts ask a thousand times a second.

Same tables and laws as `hand.kinematics` and `hand.contacts.balance_forces`, which serve batches in torch;
tests hold them together. Arrays are float64 and C-contiguous, frames are the palm's.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.hand import contacts, kinematics, leap

Array = NDArray[np.float64]

LOWER = kinematics.JOINT_LOWER.numpy().reshape(4, 4).copy()
UPPER = kinematics.JOINT_UPPER.numpy().reshape(4, 4).copy()
_POSITION, _ROTATION = (
    np.array([link.position for link in leap.LINKS]).reshape(4, 4, 3),
    kinematics.LINK_ROTATION.numpy().copy(),
)
_TIP = np.array([leap.TIP_POSITION[f] for f in leap.FINGERS])
_POSTURE_WEIGHT = kinematics.POSTURE_WEIGHT
_DAMPING, _MAX_JOINT_STEP = kinematics.DAMPING, kinematics.MAX_JOINT_STEP
_TORQUE_SCALE, _PRELOAD_WEIGHT = contacts.TORQUE_SCALE, contacts.PRELOAD_WEIGHT
_SWEEPS = 60


@numba.njit(cache=True)
def _frames(joints: Array) -> tuple[Array, Array, Array]:
    """Return joint origins (4, 4, 3), joint axes (4, 4, 3) and fingertips (4, 3)."""
    origins, axes, tips = np.empty((4, 4, 3)), np.empty((4, 4, 3)), np.empty((4, 3))
    turn, local, rotation = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    for f in range(4):
        for k in range(4):
            angle = joints[4 * f + k]
            c, s = np.cos(angle), np.sin(angle)
            turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1], turn[2, 2] = c, s, -s, c, 1.0
            local = _ROTATION[f, k] @ turn
            if k == 0:
                origins[f, k] = _POSITION[f, k]
                rotation = local
            else:
                origins[f, k] = origins[f, k - 1] + rotation @ _POSITION[f, k]
                rotation = rotation @ local
            axes[f, k] = -rotation[:, 2]
        tips[f] = origins[f, 3] + rotation @ _TIP[f]
    return origins, axes, tips


@numba.njit(cache=True)
def fingertips(joints: Array) -> Array:
    """Return the fingertips [m], shape (4, 3), of hand joints [rad], shape (16,)."""
    return _frames(joints)[2]


@numba.njit(cache=True)
def solve_fingertips(targets: Array, previous: Array) -> Array:
    """Return joints [rad] (16,) for tips [m] (4, 3): `hand.kinematics.solve_fingertips`, one row."""
    joints = previous.copy()
    for _ in range(3):
        origins, axes, tips = _frames(joints)
        for f in range(4):
            jacobian = np.empty((3, 4))
            for k in range(4):
                jacobian[:, k] = np.cross(axes[f, k], tips[f] - origins[f, k])
            error = targets[f] - tips[f]
            damping = _DAMPING**2 * (0.01 + error @ error) + _POSTURE_WEIGHT**2
            own = joints[4 * f : 4 * f + 4]
            gradient = jacobian.T @ error + _POSTURE_WEIGHT**2 * (previous[4 * f : 4 * f + 4] - own)
            step = np.linalg.solve(jacobian.T @ jacobian + damping * np.eye(4), gradient)
            largest = max(np.abs(step).max(), _MAX_JOINT_STEP)
            for k in range(4):
                moved = own[k] + step[k] * _MAX_JOINT_STEP / largest
                joints[4 * f + k] = min(max(moved, LOWER[f, k]), UPPER[f, k])
    return joints


@numba.njit(cache=True)
def contact_torques(joints: Array, points: Array, forces: Array) -> Array:
    """Return joint torques [N m] (16,) that exert forces [N] (4, 3) at points on the distal links (4, 3)."""
    origins, axes, _ = _frames(joints)
    torques = np.empty(16)
    for f in range(4):
        for k in range(4):
            torques[4 * f + k] = np.cross(axes[f, k], points[f] - origins[f, k]) @ forces[f]
    return torques


@numba.njit(cache=True)
def balance_forces(
    points: Array, inward: Array, centre: Array, wrench: Array, friction: float, preload: float
) -> tuple[Array, float]:
    """Distribute a wrench over contacts as `hand.contacts.balance_forces`, by coordinate descent."""
    n = len(points)
    system = np.empty((6, 4 * n))
    for i in range(n):
        normal = inward[i]
        helper = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.7 else np.array([0.0, 1.0, 0.0])
        first = np.cross(normal, helper)
        first /= np.sqrt(first @ first)
        second = np.cross(normal, first)
        for k in range(4):
            tangent = first if k < 2 else second
            edge = normal + (friction if k % 2 == 0 else -friction) * tangent
            system[:3, 4 * i + k] = edge
            system[3:, 4 * i + k] = _TORQUE_SCALE * np.cross(points[i] - centre, edge)
    target = wrench.copy()
    target[3:] *= _TORQUE_SCALE
    gram = system.T @ system + _PRELOAD_WEIGHT**2 * np.eye(4 * n)
    pull = system.T @ target + _PRELOAD_WEIGHT**2 * preload / 4
    weights = np.full(4 * n, preload / 4)
    for _ in range(_SWEEPS):
        for j in range(4 * n):
            weights[j] = max(0.0, weights[j] + (pull[j] - gram[j] @ weights) / gram[j, j])
    missed = system @ weights - target
    forces = np.zeros((n, 3))
    for j in range(4 * n):
        forces[j // 4] += weights[j] * system[:3, j]
    return forces, float(np.sqrt(missed @ missed))
