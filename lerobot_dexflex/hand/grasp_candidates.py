"""Propose grasps by geometry and statics: pads flat on surface points, opposed, apart, and in force closure.

Object poses are random in front of the palm. Since fingers are independent, one batched solve answers for
every finger which of its surface points it can lay its pad on; combinations are then compared at once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.hand.contacts import balance_forces, solve_pads
from lerobot_dexflex.hand.kinematics import pad_rotations
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hand.poses import quaternion_matrix
from lerobot_dexflex.hand.surfaces import surface_samples
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2]."""

_POINTS = 64
_MAX_DISTANCE = 0.003
_MIN_ALIGNMENT = 0.7
_MIN_ORDER = 0.012
_MIN_OPPOSITION = 0.3
_TUPLES = 400
_STATICS = 12
_TAKES_PART = 0.85
"""How often each finger is meant to take part; those that oppose always."""
_MAX_RESIDUAL = 0.35
_MIN_LOAD = 0.1
_MIN_PRELOAD, _PRELOAD_GAIN, _FRICTION_SHARE = 1.2, 1.5, 0.6


class Candidate(NamedTuple):
    """A grasp that geometry allows. Frames: palm."""

    position: Array
    """Object position [m]. Shape (3,)."""
    quaternion: Array
    """Object orientation (w x y z). Shape (4,)."""
    joints: Array
    """Hand joints that lay the pads on the surface [rad]. Shape (joints,)."""
    points: Array
    """Surface points under the pads [m]. Shape (fingers, 3)."""
    normals: Array
    """Outward surface normals there. Shape (fingers, 3)."""
    active: NDArray[np.bool_]
    """Which fingers take part; the others stay open. Shape (fingers,)."""


def grasp_candidates(
    hand: Hand, object_spec: ObjectSpec, rng: np.random.Generator, min_fingers: int = 3, limit: int = 2
) -> Iterator[Candidate]:
    """Draw one object pose and yield up to `limit` grasps that geometry and statics allow, best first.

    Args:
        hand: The hand that grasps.
        object_spec: What to grasp.
        rng: Source of randomness.
        min_fingers: How many fingers take part at least, one that opposes always among them; 2 or more.
        limit: How many grasps to yield at most.
    """
    position = rng.uniform(*hand.object_region)
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    rotation = quaternion_matrix(quaternion)
    local_points, local_normals = surface_samples(object_spec, _POINTS * hand.n_fingers, rng)
    shape = (_POINTS, hand.n_fingers, 3)
    points = (local_points @ rotation.T + position).reshape(shape)
    normals = (local_normals @ rotation.T).reshape(shape)
    seed = torch.tensor(hand.nominal_joints, dtype=torch.float64).expand(_POINTS, -1)
    solution = solve_pads(hand, torch.from_numpy(points), torch.from_numpy(normals), seed)
    alignment = solution.alignment.numpy()
    feasible = (solution.distance.numpy() < _MAX_DISTANCE) & (alignment > _MIN_ALIGNMENT)
    active = rng.random((_TUPLES, hand.n_fingers)) < _chances(hand)
    active &= feasible.any(0)
    opposed = active[:, hand.opposing_fingers].any(1) & active[:, hand.opposed_fingers].any(1)
    active = active[opposed & (active.sum(1) >= min_fingers)]
    if not len(active):
        return
    chosen = np.stack([_choose(ok, len(active), rng) for ok in feasible.T], 1)
    fingers = np.arange(hand.n_fingers)
    at, outward = points[chosen, fingers], normals[chosen, fingers]  # (tuples, fingers, 3)
    opposition = _opposition(hand, outward, active)
    score = (alignment[chosen, fingers] * active).sum(1) + opposition
    score[~_well_spaced(hand, at, active) | (opposition < _MIN_OPPOSITION)] = -np.inf
    best = np.argsort(-score)[:_STATICS]
    joints = solution.joints.numpy()
    finger_of_joint, joint = hand.finger_of_joint, np.arange(hand.n_joints)
    found = 0
    for k in best[np.isfinite(score[best])]:
        use = active[k]
        forces, residual = balance_weight(object_spec, at[k][use], -outward[k][use], position, np.zeros(3))
        if residual < _MAX_RESIDUAL and np.linalg.norm(forces, axis=1).min() > _MIN_LOAD:
            laid = joints[chosen[k][finger_of_joint], joint]
            posture = np.where(use[finger_of_joint], laid, hand.idle_joints)
            yield _lift_tilted(hand, Candidate(position, quaternion, posture, at[k], outward[k], use))
            found += 1
        if found == limit:
            return


def balance_weight(
    object_spec: ObjectSpec, points: Array, inward: Array, centre: Array, gravity: Array
) -> tuple[Array, float]:
    """Squeeze an object and carry its weight: `balance_forces` with margins for friction and load.

    Args:
        object_spec: The object.
        points: Contact points [m]. Shape (contacts, 3).
        inward: Unit normals into the object. Shape (contacts, 3).
        centre: Its centre of mass [m]. Shape (3,).
        gravity: Direction of gravity, or zero to ask for a pure squeeze. Shape (3,).
    """
    weight = object_spec.mass * GRAVITY
    wrench = np.concatenate([-weight * gravity, np.zeros(3)])
    preload = max(_MIN_PRELOAD, _PRELOAD_GAIN * weight)
    return balance_forces(points, inward, centre, wrench, _FRICTION_SHARE * object_spec.friction, preload)


def _lift_tilted(hand: Hand, candidate: Candidate) -> Candidate:
    """Raise pads that meet the surface at an angle, so that edges touch instead of sinking in."""
    joints, normals = torch.from_numpy(candidate.joints)[None], torch.from_numpy(candidate.normals)[None]
    half_sizes = torch.tensor([finger.pad_half_size for finger in hand.fingers], dtype=torch.float64)
    tilt = torch.einsum("bfij,bfi->bfj", pad_rotations(hand, joints), normals).abs()[..., :2]
    lift = (tilt * half_sizes).sum(-1, keepdim=True)
    points = torch.from_numpy(candidate.points)[None] + lift * normals
    solved = solve_pads(hand, points, normals, joints, iterations=4).joints[0].numpy()
    use = candidate.active[hand.finger_of_joint]
    return candidate._replace(joints=np.where(use, solved, candidate.joints), points=points[0].numpy())


def _chances(hand: Hand) -> Array:
    """Return how often each finger is meant to take part. Shape (fingers,)."""
    chances = np.full(hand.n_fingers, _TAKES_PART)
    chances[list(hand.opposing_fingers)] = 1.0
    return chances


def _choose(feasible: NDArray[np.bool_], n: int, rng: np.random.Generator) -> NDArray[np.int64]:
    options = np.flatnonzero(feasible)
    return rng.choice(options, n) if len(options) else np.zeros(n, np.int64)


def _opposition(hand: Hand, normals: Array, active: NDArray[np.bool_]) -> Array:
    """Say how much the mean normals of opposing and opposed fingers oppose, 1 = exactly. Shape (tuples,)."""
    sides = []
    for fingers in (hand.opposing_fingers, hand.opposed_fingers):
        weight = active[:, fingers, None] / active[:, fingers].sum(1)[:, None, None]
        sides.append((weight * normals[:, fingers]).sum(1))
    return -(sides[0] * sides[1]).sum(-1)


def _well_spaced(hand: Hand, points: Array, active: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Say which tuples (tuples, fingers, 3) keep the fingers apart and in the order they are mounted in."""
    first, second = np.triu_indices(points.shape[1], 1)
    idle = ~(active[:, first] & active[:, second])
    gap = points[:, first] - points[:, second]
    apart = np.linalg.norm(gap, axis=-1) > hand.pad_spacing
    opposing = np.isin(first, hand.opposing_fingers) | np.isin(second, hand.opposing_fingers)
    ordered = (gap @ hand.finger_order > _MIN_ORDER * (second - first)) | opposing
    return np.all((apart & ordered) | idle, axis=1)
