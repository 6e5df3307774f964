"""Place finger pads on surfaces and balance the forces they exert: the geometry and statics of a grasp."""

from typing import NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import nnls
from torch import Tensor

from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.kinematics import as_array, pads
from lerobot_dexflex.hands import PALM, Hand

Array = NDArray[np.float64]

CONTACT_FORCE = 0.05
"""A finger counts as loaded from this normal force on [N]."""
TORQUE_SCALE, PRELOAD_WEIGHT = 40.0, 0.3
"""Of the force balance: newtons that 1 N m counts as [1/m], and the weight of the wish for preload."""


class FingertipContacts(NamedTuple):
    """What the fingertips do to an object, in the world frame."""

    loads: Array
    """Normal force of each fingertip [N]. Shape (fingers,)."""
    points: Array
    """Load-weighted contact points [m]; zero where a finger does not touch. Shape (fingers, 3)."""
    inward: Array
    """Unit contact normals into the object; zero where a finger does not touch. Shape (fingers, 3)."""


class PadSolution(NamedTuple):
    """Joints that place pads on surface points, and how well they do."""

    joints: Tensor
    """Hand joints within the limits [rad]. Shape (batch, joints)."""
    distance: Tensor
    """Distance from every pad centre to its point [m]. Shape (batch, fingers)."""
    alignment: Tensor
    """Cosine between the pads' inward and the surfaces' outward normals. Shape (batch, fingers)."""


def fingertip_contacts(
    hand: Hand, model: mujoco.MjModel, data: mujoco.MjData, body: str
) -> FingertipContacts:
    """Read the contacts between the distal links and a body from simulation data (after `mj_forward`)."""
    touched = model.body(body).id
    finger_of = {model.body(name).id: k for k, name in enumerate(hand.distal_links)}
    loads = np.zeros(hand.n_fingers)
    points, normals = np.zeros((hand.n_fingers, 3)), np.zeros((hand.n_fingers, 3))
    force = np.zeros(6)
    for k, contact in enumerate(data.contact):
        bodies = model.geom_bodyid[contact.geom]
        finger = finger_of.get(bodies[0], finger_of.get(bodies[1]))
        if finger is None or touched not in bodies:
            continue
        mujoco.mj_contactForce(model, data, k, force)
        toward_object = 1.0 if bodies[1] == touched else -1.0
        loads[finger] += force[0]
        points[finger] += force[0] * contact.pos
        normals[finger] += force[0] * toward_object * contact.frame[:3]
    points /= np.maximum(loads, 1e-9)[:, None]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return FingertipContacts(loads, points, normals)


def contact_names(model: mujoco.MjModel, data: mujoco.MjData, body: str) -> set[str]:
    """Return what pushes on a body: names of moving bodies and, of what stands still, names of geoms."""
    touched = model.body(body).id
    found, force = set(), np.zeros(6)
    for k, contact in enumerate(data.contact):
        bodies = model.geom_bodyid[contact.geom]
        if touched not in bodies:
            continue
        mujoco.mj_contactForce(model, data, k, force)
        other = int(bodies[0] == touched)
        if not model.body_jntnum[bodies[other]]:
            found.add(model.geom(contact.geom[other]).name)
        elif force[0] > CONTACT_FORCE:
            found.add(model.body(bodies[other]).name)
    return found


def touched_by_hand(hand: Hand, names: set[str]) -> bool:
    """Say whether a link of the hand is among the names of `contact_names`."""
    return any(name in hand.link_names or name.startswith(PALM) for name in names)


def pinched(hand: Hand, names: set[str]) -> bool:
    """Say whether tips of a finger that opposes and of one that is opposed are among `contact_names`."""
    tips = hand.distal_links
    return any(tips[k] in names for k in hand.opposing_fingers) and any(
        tips[k] in names for k in hand.opposed_fingers
    )


def contact_flags(hand: Hand, names: set[str]) -> NDArray[np.bool_]:
    """Say whether each tip, then anything but the hand, is among `contact_names`. Shape (fingers + 1,)."""
    tips = [name in names for name in hand.distal_links]
    return np.array([*tips, any(not touched_by_hand(hand, {name}) for name in names)])


def solve_pads(
    hand: Hand, points: Tensor, normals: Tensor, seed: Tensor, iterations: int = 12
) -> PadSolution:
    """Find joints that lay each pad flat on a surface point: damped least squares, one finger at a time.

    Fingers are independent, so a row may hold unrelated questions, one per finger.

    Args:
        hand: Whose pads.
        points: Where the pad centres should be, palm frame [m]. Shape (batch, fingers, 3).
        normals: Outward unit surface normals there, palm frame. Shape (batch, fingers, 3).
        seed: Start and weakly preferred posture [rad]. Shape (batch, joints).
        iterations: Gauss-Newton steps.
    """
    shape = (-1, hand.n_fingers, 3)
    arrays = as_array(points, shape), as_array(normals, shape), as_array(seed, (-1, hand.n_joints))
    joints = torch.from_numpy(kernels.solve_pads(hand.tables, *arrays, int(iterations))).to(seed)
    centres, outward = pads(hand, joints)
    return PadSolution(joints, (points - centres).norm(dim=-1), -(normals * outward).sum(-1))


def gripping_joints(hand: Hand, targets: Array, joints: Array, points: Array, forces: Array) -> Array:
    """Return joint targets [rad] (joints,) within the limits that also exert forces, by leading the joints.

    Args:
        hand: Whose joints.
        targets: Joint targets without the forces [rad]. Shape (joints,).
        joints: Measured joints [rad]. Shape (joints,).
        points: Where the fingers press [m], palm frame. Shape (fingers, 3).
        forces: Forces of the fingers on what they touch [N], palm frame. Shape (fingers, 3).
    """
    torques = kernels.contact_torques(hand.tables, joints, points, forces)
    leads = np.clip(torques, -hand.grip_torques, hand.grip_torques) / hand.position_gains
    return np.clip(targets + leads, hand.joint_lower, hand.joint_upper)


def balance_forces(
    points: Array, inward: Array, centre: Array, wrench: Array, friction: float, preload: float
) -> tuple[Array, float]:
    """Distribute a wrench over frictional contacts: non-negative least squares over friction-cone edges.

    The preload is what every contact would carry if nothing else mattered, hence the internal squeeze.

    Args:
        points: Contact points [m]. Shape (contacts, 3).
        inward: Unit normals into the object. Shape (contacts, 3).
        centre: Point about which the torque is taken [m]. Shape (3,).
        wrench: Wanted force [N] and torque [N m] on the object. Shape (6,).
        friction: Usable friction coefficient.
        preload: Wanted normal force of every contact [N].

    Returns:
        Forces on the object [N], shape (contacts, 3), and what the wrench misses [N], a torque of
        1 N m counting as 40 N.
    """
    first, second = _tangents(inward)
    spread = np.stack([first, -first, second, -second], 1)
    edges = (inward[:, None] + friction * spread).reshape(-1, 3)  # (4 contacts, 3)
    torques = np.cross(np.repeat(points - centre, 4, 0), edges)
    system = np.vstack([edges.T, TORQUE_SCALE * torques.T])
    target = np.concatenate([wrench[:3], TORQUE_SCALE * wrench[3:]])
    n = len(edges)
    weights, _ = nnls(
        np.vstack([system, PRELOAD_WEIGHT * np.eye(n)]),
        np.concatenate([target, np.full(n, PRELOAD_WEIGHT * preload / 4)]),
    )
    forces = (weights[:, None] * edges).reshape(-1, 4, 3).sum(1)
    return forces, float(np.linalg.norm(system @ weights - target))


def _tangents(normals: Array) -> tuple[Array, Array]:
    helper = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)
