"""The hand's kinematics, compiled: every hand for itself, in plain loops.

A batch therefore equals its rows to the last bit: no BLAS, no LAPACK and no fast-math choose an order of
summation by the size of the batch or the make of the processor. Experts ask for one hand, a thousand times a
second; `hand.kinematics` and `hand.contacts` ask for batches of tensors. Arrays are float64 and C-contiguous,
with any or no batch dimensions in front; frames are the palm's; a finger whose wish is NaN becomes NaN.

Numba keeps what it compiled until this file changes, and the hand's tables are compiled in: delete
`__pycache__` after a change of `leap.py`. Functions that call each other stay in one file for that reason.
"""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.compiled import compiled
from lerobot_dexflex.hand import leap
from lerobot_dexflex.hand.body import Quaternion

Array = NDArray[np.float64]

POSTURE_WEIGHT = 0.02
"""Weight of the tie to the previous joint command [m/rad]: a fingertip leaves one joint per finger free."""
_DAMPING, _MAX_JOINT_STEP = 0.01, 0.5
"""Of `solve_fingertips`: damping [m/rad] and the largest step [rad]."""
_PAD_POSTURE_WEIGHT, _PAD_DAMPING, _PAD_MAX_JOINT_STEP, _NORMAL_WEIGHT = 0.002, 0.004, 0.4, 0.005
"""Of `solve_pads`: the same, and the weight of a pad's direction [m]."""


def _rotation(quaternion: Quaternion) -> Array:
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


LOWER, UPPER = (np.array([link.joint_range[end] for link in leap.LINKS]).reshape(4, 4) for end in (0, 1))
"""Joint limits [rad]. Shape (fingers, joints)."""
_POSITION = np.array([link.position for link in leap.LINKS]).reshape(4, 4, 3)
_ROTATION = np.array([_rotation(link.quaternion) for link in leap.LINKS]).reshape(4, 4, 3, 3)
_TIP = np.array([leap.TIP_POSITION[f] for f in leap.FINGERS])
_PAD = np.array([leap.PAD_POSITION[f] for f in leap.FINGERS])


@compiled
def _follow(f: int, angles: Array, origins: Array, axes: Array, rotation: Array) -> None:
    """Follow finger f to its distal link: write origins (4, 3), axes (4, 3) and distal rotation (3, 3)."""
    for i in range(3):
        for j in range(3):
            rotation[i, j] = 1.0 if i == j else 0.0
    for k in range(4):
        cos, sin = np.cos(angles[k]), np.sin(angles[k])
        position, link = _POSITION[f, k], _ROTATION[f, k]
        for i in range(3):
            a, b, c = rotation[i, 0], rotation[i, 1], rotation[i, 2]
            before = origins[k - 1, i] if k else 0.0
            origins[k, i] = before + (a * position[0] + b * position[1] + c * position[2])
            x = a * link[0, 0] + b * link[1, 0] + c * link[2, 0]
            y = a * link[0, 1] + b * link[1, 1] + c * link[2, 1]
            z = a * link[0, 2] + b * link[1, 2] + c * link[2, 2]
            # Every LEAP joint turns about -z of its own link.
            rotation[i, 0], rotation[i, 1], rotation[i, 2] = cos * x - sin * y, sin * x + cos * y, z
            axes[k, i] = -z


@compiled
def _place(local: Array, origin: Array, rotation: Array, point: Array) -> None:
    """Write where a point of the distal link is."""
    for i in range(3):
        moved = rotation[i, 0] * local[0] + rotation[i, 1] * local[1] + rotation[i, 2] * local[2]
        point[i] = origin[i] + moved


@compiled
def _turning(axes: Array, arms: Array, motions: Array) -> None:
    """Write the motions `axis x arm` of a finger's four joints, each (4, 3)."""
    for k in range(4):
        a, r = axes[k], arms[k]
        motions[k, 0] = a[1] * r[2] - a[2] * r[1]
        motions[k, 1] = a[2] * r[0] - a[0] * r[2]
        motions[k, 2] = a[0] * r[1] - a[1] * r[0]


@compiled
def _damped_step(motions: Array, error: Array, pull: Array, damping: float, step: Array) -> None:
    """Write the step (4,) that solves (J J^T + damping) step = J error + pull, with J = motions (4, n).

    By Cholesky's factors: the matrix is symmetric, and positive definite because of its damping.
    """
    lower = np.empty((4, 4))
    for i in range(4):
        right = pull[i]
        for m in range(len(error)):
            right += motions[i, m] * error[m]
        for j in range(i + 1):
            entry = damping if i == j else 0.0
            for m in range(len(error)):
                entry += motions[i, m] * motions[j, m]
            for m in range(j):
                entry -= lower[i, m] * lower[j, m]
            lower[i, j] = np.sqrt(entry) if i == j else entry / lower[j, j]
        for m in range(i):
            right -= lower[i, m] * step[m]
        step[i] = right / lower[i, i]
    for i in range(3, -1, -1):
        for m in range(i + 1, 4):
            step[i] -= lower[m, i] * step[m]
        step[i] /= lower[i, i]


@compiled
def _move(f: int, joints: Array, step: Array) -> None:
    """Add a step to the joints (4,) of finger f, within their limits; NaN stays NaN."""
    for k in range(4):
        joints[k] += step[k]
        if joints[k] < LOWER[f, k]:
            joints[k] = LOWER[f, k]
        elif joints[k] > UPPER[f, k]:
            joints[k] = UPPER[f, k]


@compiled
def frames(joints: Array) -> tuple[Array, Array, Array]:
    """Return the frames of all fingers: see `hand.kinematics.FingerFrames`. Shape of `joints`: (..., 16)."""
    hands, shape = joints.reshape(-1, 16), joints.shape[:-1]
    n = len(hands)
    origins, axes, rotations = np.empty((n, 4, 4, 3)), np.empty((n, 4, 4, 3)), np.empty((n, 4, 3, 3))
    for row in range(n):
        for f in range(4):
            angles = hands[row, 4 * f : 4 * f + 4]
            _follow(f, angles, origins[row, f], axes[row, f], rotations[row, f])
    return (
        origins.reshape((*shape, 4, 4, 3)),
        axes.reshape((*shape, 4, 4, 3)),
        rotations.reshape((*shape, 4, 3, 3)),
    )


@compiled
def fingertips(joints: Array) -> Array:
    """Return the fingertips [m], shape (..., 4, 3), of hand joints [rad], shape (..., 16)."""
    hands = joints.reshape(-1, 16)
    tips = np.empty((len(hands), 4, 3))
    origins, axes, rotation = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    for row in range(len(hands)):
        for f in range(4):
            _follow(f, hands[row, 4 * f : 4 * f + 4], origins, axes, rotation)
            _place(_TIP[f], origins[3], rotation, tips[row, f])
    return tips.reshape((*joints.shape[:-1], 4, 3))


@compiled
def pads(joints: Array) -> tuple[Array, Array]:
    """Return pad centres [m] and outward pad normals, each (..., 4, 3), of hand joints [rad], (..., 16)."""
    hands, shape = joints.reshape(-1, 16), (*joints.shape[:-1], 4, 3)
    centres, normals = np.empty((len(hands), 4, 3)), np.empty((len(hands), 4, 3))
    origins, axes, rotation = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    for row in range(len(hands)):
        for f in range(4):
            _follow(f, hands[row, 4 * f : 4 * f + 4], origins, axes, rotation)
            _place(_PAD[f], origins[3], rotation, centres[row, f])
            for i in range(3):
                normals[row, f, i] = -rotation[i, 0]
    return centres.reshape(shape), normals.reshape(shape)


@compiled
def contact_torques(joints: Array, points: Array, forces: Array) -> Array:
    """Return the joint torques [N m], shape (..., 16), with which the fingertips exert forces.

    Args:
        joints: Joint positions [rad]. Shape (..., 16).
        points: Contact points on the four distal links, palm frame [m]. Shape (..., 4, 3).
        forces: Forces of the fingers on what they touch, palm frame [N]. Shape (..., 4, 3).
    """
    hands, places, wanted = joints.reshape(-1, 16), points.reshape(-1, 4, 3), forces.reshape(-1, 4, 3)
    if not len(hands) == len(places) == len(wanted):
        raise ValueError("`joints`, `points` and `forces` must have as many rows.")
    torques, arms, motions = np.empty((len(hands), 16)), np.empty((4, 3)), np.empty((4, 3))
    origins, axes, rotation = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    for row in range(len(hands)):
        for f in range(4):
            _follow(f, hands[row, 4 * f : 4 * f + 4], origins, axes, rotation)
            for k in range(4):
                for i in range(3):
                    arms[k, i] = places[row, f, i] - origins[k, i]
            _turning(axes, arms, motions)
            for k in range(4):
                m, force = motions[k], wanted[row, f]
                torques[row, 4 * f + k] = m[0] * force[0] + m[1] * force[1] + m[2] * force[2]
    return torques.reshape(joints.shape)


@compiled
def solve_fingertips(
    targets: Array, previous: Array, posture_weight: float = POSTURE_WEIGHT, iterations: int = 3
) -> Array:
    """Return joints [rad] (..., 16) for tips [m] (..., 4, 3), as `kinematics.solve_fingertips` says."""
    wanted, seeds, joints = (
        targets.reshape(-1, 4, 3),
        previous.reshape(-1, 16),
        previous.copy().reshape(-1, 16),
    )
    if len(wanted) != len(seeds):
        raise ValueError("`targets` and `previous` must have as many rows.")
    origins, axes, rotation = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    tip, error, step, pull = np.empty(3), np.empty(3), np.empty(4), np.empty(4)
    arms, motions = np.empty((4, 3)), np.empty((4, 3))
    for row in range(len(joints)):
        for f in range(4):
            own, posture = joints[row, 4 * f : 4 * f + 4], seeds[row, 4 * f : 4 * f + 4]
            for _ in range(iterations):
                _follow(f, own, origins, axes, rotation)
                _place(_TIP[f], origins[3], rotation, tip)
                squared = 0.0
                for i in range(3):
                    error[i] = wanted[row, f, i] - tip[i]
                    squared += error[i] * error[i]
                for k in range(4):
                    pull[k] = posture_weight**2 * (posture[k] - own[k])
                    for i in range(3):
                        arms[k, i] = tip[i] - origins[k, i]
                _turning(axes, arms, motions)
                damping = _DAMPING**2 * (0.01 + squared) + posture_weight**2
                _damped_step(motions, error, pull, damping, step)
                largest = _MAX_JOINT_STEP
                for k in range(4):
                    largest = max(largest, abs(step[k]))
                for k in range(4):
                    step[k] *= _MAX_JOINT_STEP / largest
                _move(f, own, step)
    return joints.reshape(previous.shape)


@compiled
def solve_pads(points: Array, normals: Array, seed: Array, iterations: int = 12) -> Array:
    """Return joints [rad] (..., 16) for pads on points [m] (..., 4, 3), as `contacts.solve_pads` says."""
    wanted, outward = points.reshape(-1, 4, 3), normals.reshape(-1, 4, 3)
    seeds, joints = seed.reshape(-1, 16), seed.copy().reshape(-1, 16)
    if not len(wanted) == len(outward) == len(seeds):
        raise ValueError("`points`, `normals` and `seed` must have as many rows.")
    origins, axes, rotation = np.empty((4, 3)), np.empty((4, 3)), np.empty((3, 3))
    centre, error, step, pull = np.empty(3), np.empty(6), np.empty(4), np.empty(4)
    arms, facing, motions = np.empty((4, 3)), np.empty((4, 3)), np.empty((4, 6))
    for row in range(len(joints)):
        for f in range(4):
            own, posture = joints[row, 4 * f : 4 * f + 4], seeds[row, 4 * f : 4 * f + 4]
            for _ in range(iterations):
                _follow(f, own, origins, axes, rotation)
                _place(_PAD[f], origins[3], rotation, centre)
                for i in range(3):
                    error[i] = wanted[row, f, i] - centre[i]
                    error[3 + i] = -_NORMAL_WEIGHT * (outward[row, f, i] - rotation[i, 0])
                for k in range(4):
                    pull[k] = _PAD_POSTURE_WEIGHT**2 * (posture[k] - own[k])
                    for i in range(3):
                        arms[k, i] = centre[i] - origins[k, i]
                        facing[k, i] = -_NORMAL_WEIGHT * rotation[i, 0]
                _turning(axes, arms, motions[:, :3])
                _turning(axes, facing, motions[:, 3:])
                _damped_step(motions, error, pull, _PAD_DAMPING**2 + _PAD_POSTURE_WEIGHT**2, step)
                for k in range(4):
                    if abs(step[k]) > _PAD_MAX_JOINT_STEP:
                        step[k] = np.copysign(_PAD_MAX_JOINT_STEP, step[k])
                _move(f, own, step)
    return joints.reshape(seed.shape)
