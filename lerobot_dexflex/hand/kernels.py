"""The hand's kinematics, compiled: every hand for itself, in plain loops.

A batch therefore equals its rows to the last bit: no BLAS, no LAPACK and no fast-math choose an order of
summation by the size of the batch or the make of the processor. Experts ask for one hand, a thousand times a
second; `hand.kinematics` and `hand.contacts` ask for batches of tensors. Arrays are float64 and C-contiguous,
with any or no batch dimensions in front; frames are the palm's; a finger whose wish is NaN becomes NaN.

The hand comes as its `tables` (`hands.tables.Tables`), the first argument, so that one machine code serves
all hands. Numba keeps what it compiled until this file changes: functions that call each other stay in one
file for that reason, and a change of the fields of `Tables` needs `__pycache__` deleted.
"""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.compiled import compiled
from lerobot_dexflex.hands.tables import Tables

Array = NDArray[np.float64]

POSTURE_WEIGHT = 0.02
"""Weight of the tie to the previous joint command [m/rad]: a point leaves joints of a finger free."""
_DAMPING, _MAX_JOINT_STEP = 0.01, 0.5
"""Of `solve_fingertips`: damping [m/rad] and the largest step [rad]."""
_PAD_POSTURE_WEIGHT, _PAD_DAMPING, _PAD_MAX_JOINT_STEP, _NORMAL_WEIGHT = 0.002, 0.004, 0.4, 0.005
"""Of `solve_pads`: the same, and the weight of a pad's direction [m]."""


@compiled
def _follow(tables: Tables, f: int, angles: Array, origins: Array, axes: Array, rotation: Array) -> None:
    """Follow finger f to its distal link: write its joints' origins and axes and the turned distal frame.

    Shapes: (joints, 3) or more rows, of which the rest is left alone, and (3, 3).
    """
    for i in range(3):
        for j in range(3):
            rotation[i, j] = 1.0 if i == j else 0.0
    for k in range(len(angles)):
        cos, sin = np.cos(angles[k]), np.sin(angles[k])
        joint = tables.starts[f] + k
        position, link = tables.positions[joint], tables.rotations[joint]
        for i in range(3):
            a, b, c = rotation[i, 0], rotation[i, 1], rotation[i, 2]
            before = origins[k - 1, i] if k else 0.0
            origins[k, i] = before + (a * position[0] + b * position[1] + c * position[2])
            x = a * link[0, 0] + b * link[1, 0] + c * link[2, 0]
            y = a * link[0, 1] + b * link[1, 1] + c * link[2, 1]
            z = a * link[0, 2] + b * link[1, 2] + c * link[2, 2]
            # Every joint turns about -z of its turned frame: see `hands.tables`.
            rotation[i, 0], rotation[i, 1], rotation[i, 2] = cos * x - sin * y, sin * x + cos * y, z
            axes[k, i] = -z


@compiled
def _place(local: Array, origin: Array, rotation: Array, point: Array) -> None:
    """Write where a point of the distal link is."""
    for i in range(3):
        moved = rotation[i, 0] * local[0] + rotation[i, 1] * local[1] + rotation[i, 2] * local[2]
        point[i] = origin[i] + moved


@compiled
def _point(rotation: Array, local: Array, direction: Array) -> None:
    """Write where a direction of the distal link points."""
    for i in range(3):
        direction[i] = rotation[i, 0] * local[0] + rotation[i, 1] * local[1] + rotation[i, 2] * local[2]


@compiled
def _turning(n: int, axes: Array, arms: Array, motions: Array) -> None:
    """Write the motions `axis x arm` of a finger's n joints, each (n, 3) or more rows."""
    for k in range(n):
        a, r = axes[k], arms[k]
        motions[k, 0] = a[1] * r[2] - a[2] * r[1]
        motions[k, 1] = a[2] * r[0] - a[0] * r[2]
        motions[k, 2] = a[0] * r[1] - a[1] * r[0]


@compiled
def _damped_step(n: int, motions: Array, error: Array, pull: Array, damping: float, step: Array) -> None:
    """Write the step (n,) that solves (J J^T + damping) step = J error + pull, with J = motions (n, m).

    By Cholesky's factors: the matrix is symmetric, and positive definite because of its damping.
    """
    lower = np.empty((n, n))
    for i in range(n):
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
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, n):
            step[i] -= lower[m, i] * step[m]
        step[i] /= lower[i, i]


@compiled
def _move(tables: Tables, f: int, joints: Array, step: Array) -> None:
    """Add a step to the joints of finger f, within their limits; NaN stays NaN."""
    start = tables.starts[f]
    for k in range(len(joints)):
        joints[k] += step[k]
        if joints[k] < tables.lower[start + k]:
            joints[k] = tables.lower[start + k]
        elif joints[k] > tables.upper[start + k]:
            joints[k] = tables.upper[start + k]


@compiled
def frames(tables: Tables, joints: Array) -> tuple[Array, Array, Array]:
    """Return the frames of all fingers: see `hand.kinematics.FingerFrames`.

    Args:
        tables: The hand.
        joints: Joint positions [rad]. Shape (..., joints).
    """
    fingers, widest, shape = len(tables.ends), tables.widest, joints.shape[:-1]
    hands = joints.reshape(-1, len(tables.lower))
    n = len(hands)
    origins, axes = np.zeros((n, fingers, widest, 3)), np.zeros((n, fingers, widest, 3))
    rotations, turned = np.empty((n, fingers, 3, 3)), np.empty((3, 3))
    for row in range(n):
        for f in range(fingers):
            angles = hands[row, tables.starts[f] : tables.starts[f + 1]]
            _follow(tables, f, angles, origins[row, f], axes[row, f], rotations[row, f])
            if tables.turned[f]:
                turned[:] = rotations[row, f]
                for i in range(3):
                    _point(tables.turns[f], turned[i], rotations[row, f, i])
    return (
        origins.reshape((*shape, fingers, widest, 3)),
        axes.reshape((*shape, fingers, widest, 3)),
        rotations.reshape((*shape, fingers, 3, 3)),
    )


@compiled
def fingertips(tables: Tables, joints: Array) -> Array:
    """Return the fingertips [m], shape (..., fingers, 3), of hand joints [rad], shape (..., joints)."""
    fingers, hands = len(tables.ends), joints.reshape(-1, len(tables.lower))
    tips = np.empty((len(hands), fingers, 3))
    origins, axes, rotation = np.empty((tables.widest, 3)), np.empty((tables.widest, 3)), np.empty((3, 3))
    for row in range(len(hands)):
        for f in range(fingers):
            angles = hands[row, tables.starts[f] : tables.starts[f + 1]]
            _follow(tables, f, angles, origins, axes, rotation)
            _place(tables.ends[f, 0], origins[len(angles) - 1], rotation, tips[row, f])
    return tips.reshape((*joints.shape[:-1], fingers, 3))


@compiled
def pads(tables: Tables, joints: Array) -> tuple[Array, Array]:
    """Return pad centres [m] and outward normals, each (..., fingers, 3), of joints [rad] (..., joints)."""
    fingers, hands = len(tables.ends), joints.reshape(-1, len(tables.lower))
    shape = (*joints.shape[:-1], fingers, 3)
    centres, normals = np.empty((len(hands), fingers, 3)), np.empty((len(hands), fingers, 3))
    origins, axes, rotation = np.empty((tables.widest, 3)), np.empty((tables.widest, 3)), np.empty((3, 3))
    inward = np.empty(3)
    for row in range(len(hands)):
        for f in range(fingers):
            angles = hands[row, tables.starts[f] : tables.starts[f + 1]]
            _follow(tables, f, angles, origins, axes, rotation)
            _place(tables.ends[f, 1], origins[len(angles) - 1], rotation, centres[row, f])
            _point(rotation, tables.ends[f, 2], inward)
            for i in range(3):
                normals[row, f, i] = -inward[i]
    return centres.reshape(shape), normals.reshape(shape)


@compiled
def contact_torques(tables: Tables, joints: Array, points: Array, forces: Array) -> Array:
    """Return the joint torques [N m], shape (..., joints), with which the fingertips exert forces.

    Args:
        tables: The hand.
        joints: Joint positions [rad]. Shape (..., joints).
        points: Contact points on the distal links, palm frame [m]. Shape (..., fingers, 3).
        forces: Forces of the fingers on what they touch, palm frame [N]. Shape (..., fingers, 3).
    """
    fingers, widest = len(tables.ends), tables.widest
    hands = joints.reshape(-1, len(tables.lower))
    places, wanted = points.reshape(-1, fingers, 3), forces.reshape(-1, fingers, 3)
    if not len(hands) == len(places) == len(wanted):
        raise ValueError("`joints`, `points` and `forces` must have as many rows.")
    torques, arms, motions = np.empty(hands.shape), np.empty((widest, 3)), np.empty((widest, 3))
    origins, axes, rotation = np.empty((widest, 3)), np.empty((widest, 3)), np.empty((3, 3))
    for row in range(len(hands)):
        for f in range(fingers):
            angles = hands[row, tables.starts[f] : tables.starts[f + 1]]
            n = len(angles)
            _follow(tables, f, angles, origins, axes, rotation)
            for k in range(n):
                for i in range(3):
                    arms[k, i] = places[row, f, i] - origins[k, i]
            _turning(n, axes, arms, motions)
            for k in range(n):
                m, force = motions[k], wanted[row, f]
                torques[row, tables.starts[f] + k] = m[0] * force[0] + m[1] * force[1] + m[2] * force[2]
    return torques.reshape(joints.shape)


@compiled
def solve_fingertips(
    tables: Tables,
    targets: Array,
    previous: Array,
    posture_weight: float = POSTURE_WEIGHT,
    iterations: int = 3,
) -> Array:
    """Return joints [rad] (..., joints) for tips [m] (..., fingers, 3): `kinematics.solve_fingertips`."""
    fingers, widest = len(tables.ends), tables.widest
    wanted, seeds = targets.reshape(-1, fingers, 3), previous.reshape(-1, len(tables.lower))
    joints = previous.copy().reshape(-1, len(tables.lower))
    if len(wanted) != len(seeds):
        raise ValueError("`targets` and `previous` must have as many rows.")
    origins, axes, rotation = np.empty((widest, 3)), np.empty((widest, 3)), np.empty((3, 3))
    tip, error, step, pull = np.empty(3), np.empty(3), np.empty(widest), np.empty(widest)
    arms, motions = np.empty((widest, 3)), np.empty((widest, 3))
    for row in range(len(joints)):
        for f in range(fingers):
            start, end = tables.starts[f], tables.starts[f + 1]
            n, own, posture = end - start, joints[row, start:end], seeds[row, start:end]
            for _ in range(iterations):
                _follow(tables, f, own, origins, axes, rotation)
                _place(tables.ends[f, 0], origins[n - 1], rotation, tip)
                squared = 0.0
                for i in range(3):
                    error[i] = wanted[row, f, i] - tip[i]
                    squared += error[i] * error[i]
                for k in range(n):
                    pull[k] = posture_weight**2 * (posture[k] - own[k])
                    for i in range(3):
                        arms[k, i] = tip[i] - origins[k, i]
                _turning(n, axes, arms, motions)
                damping = _DAMPING**2 * (0.01 + squared) + posture_weight**2
                _damped_step(n, motions, error, pull, damping, step)
                largest = _MAX_JOINT_STEP
                for k in range(n):
                    largest = max(largest, abs(step[k]))
                for k in range(n):
                    step[k] *= _MAX_JOINT_STEP / largest
                _move(tables, f, own, step)
    return joints.reshape(previous.shape)


@compiled
def solve_pads(tables: Tables, points: Array, normals: Array, seed: Array, iterations: int = 12) -> Array:
    """Return joints [rad] (..., joints) for pads on points [m] (..., fingers, 3): `contacts.solve_pads`."""
    fingers, widest = len(tables.ends), tables.widest
    wanted, outward = points.reshape(-1, fingers, 3), normals.reshape(-1, fingers, 3)
    seeds, joints = seed.reshape(-1, len(tables.lower)), seed.copy().reshape(-1, len(tables.lower))
    if not len(wanted) == len(outward) == len(seeds):
        raise ValueError("`points`, `normals` and `seed` must have as many rows.")
    origins, axes, rotation = np.empty((widest, 3)), np.empty((widest, 3)), np.empty((3, 3))
    centre, inward, error = np.empty(3), np.empty(3), np.empty(6)
    step, pull = np.empty(widest), np.empty(widest)
    arms, facing, motions = np.empty((widest, 3)), np.empty((widest, 3)), np.empty((widest, 6))
    for row in range(len(joints)):
        for f in range(fingers):
            start, end = tables.starts[f], tables.starts[f + 1]
            n, own, posture = end - start, joints[row, start:end], seeds[row, start:end]
            for _ in range(iterations):
                _follow(tables, f, own, origins, axes, rotation)
                _place(tables.ends[f, 1], origins[n - 1], rotation, centre)
                _point(rotation, tables.ends[f, 2], inward)
                for i in range(3):
                    error[i] = wanted[row, f, i] - centre[i]
                    error[3 + i] = -_NORMAL_WEIGHT * (outward[row, f, i] - inward[i])
                for k in range(n):
                    pull[k] = _PAD_POSTURE_WEIGHT**2 * (posture[k] - own[k])
                    for i in range(3):
                        arms[k, i] = centre[i] - origins[k, i]
                        facing[k, i] = -_NORMAL_WEIGHT * inward[i]
                _turning(n, axes, arms, motions[:, :3])
                _turning(n, axes, facing, motions[:, 3:])
                _damped_step(n, motions, error, pull, _PAD_DAMPING**2 + _PAD_POSTURE_WEIGHT**2, step)
                for k in range(n):
                    if abs(step[k]) > _PAD_MAX_JOINT_STEP:
                        step[k] = np.copysign(_PAD_MAX_JOINT_STEP, step[k])
                _move(tables, f, own, step)
    return joints.reshape(seed.shape)
