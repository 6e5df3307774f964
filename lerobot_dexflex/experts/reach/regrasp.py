"""Find new places for a finger on the object: reachable by its pad now and at the goal, apart, in balance."""

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.balance import balance_forces
from lerobot_dexflex.experts.reach.fingers import Holder, Mode
from lerobot_dexflex.experts.reach.sensing import HandState
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import solve_pads
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hand.poses import quaternion_matrix

Array = NDArray[np.float64]

_POINTS = 40
_MAX_DISTANCE, _MIN_ALIGNMENT = 0.004, 0.6
_NEARER = 0.001
"""By so much less than grasps are sought with may a finger be away from the others [m]."""
_MAX_RESIDUAL, _FIRM_RESIDUAL, _FIRM_LOAD = 0.5, 0.15, 0.2
_FRICTION_SHARE = 0.5


def regrasp_points(
    holder: Holder,
    now: HandState,
    finger: int,
    surface: tuple[Array, Array],
    rng: np.random.Generator,
    firm: bool = False,
    limit: int = 2,
) -> list[tuple[Array, Array]]:
    """Return up to `limit` new anchors of a finger and their inward normals, both in the object's frame.

    Args:
        holder: Who holds the object, and where it should go.
        now: The state.
        finger: Index of the finger.
        surface: Points [m] and outward normals of the object in its frame, each (n, 3).
        rng: Source of randomness.
        firm: Whether the other fingers must hold the object well without this one.
        limit: How many to return.
    """
    hand, fingers = holder.senses.hand, holder.fingers
    others = np.array([k for k in range(hand.n_fingers) if k != finger and fingers.mode[k] == Mode.HOLD], int)
    if len(others) < 2 or (firm and not _holds(holder, now, others)):
        return []
    points, normals = surface
    goal, goal_quaternion = holder.goal
    rotation = quaternion_matrix(goal_quaternion)
    at_goal, at_now = points @ rotation.T + goal, points @ now.rotation.T + now.position
    home = kernels.fingertips(hand.tables, np.array(hand.nominal_joints))[finger]
    cost = np.linalg.norm(at_goal - home, axis=1) + 0.5 * np.linalg.norm(at_now - now.tips[finger], axis=1)
    cost += 0.008 * np.abs(rng.normal(size=len(points)))
    apart = np.linalg.norm(at_now[:, None] - now.points[others], axis=-1).min(1)
    close = apart < hand.pad_spacing - _NEARER
    order = np.argsort(cost + 10.0 * close)[:_POINTS]
    order = order[~close[order]]
    if not len(order):
        return []
    shape = (len(order), hand.n_fingers, 3)
    joints = np.broadcast_to(now.joints, (len(order), hand.n_joints)).copy()
    solution = solve_pads(
        hand,
        torch.from_numpy(np.broadcast_to(at_now[order][:, None], shape).copy()),
        torch.from_numpy(np.broadcast_to((normals[order] @ now.rotation.T)[:, None], shape).copy()),
        torch.from_numpy(joints),
        iterations=8,
    )
    fits = (solution.distance[:, finger] < _MAX_DISTANCE) & (solution.alignment[:, finger] > _MIN_ALIGNMENT)
    tips = fingertips(hand, solution.joints)[:, finger].numpy()
    found = []
    for k in np.flatnonzero(fits.numpy()):
        point, inward = at_now[order[k]], -now.rotation @ normals[order[k]]
        if _balance(holder, now, others, (point, inward))[1] < _MAX_RESIDUAL:
            found.append(((tips[k] - now.position) @ now.rotation, -normals[order[k]]))
        if len(found) == limit:
            break
    return found


def _holds(holder: Holder, now: HandState, fingers: NDArray[np.int64]) -> bool:
    forces, residual = _balance(holder, now, fingers)
    return residual < _FIRM_RESIDUAL and np.linalg.norm(forces, axis=1).min() > _FIRM_LOAD


def _balance(
    holder: Holder,
    now: HandState,
    fingers: NDArray[np.int64],
    extra: tuple[Array, Array] | None = None,
) -> tuple[Array, float]:
    """Return forces [N] with which fingers (and one more contact) carry the object, and what they miss."""
    points, inward = now.points[fingers], holder.fingers.inward[fingers] @ now.rotation.T
    if extra is not None:
        points, inward = np.vstack([points, extra[0]]), np.vstack([inward, extra[1]])
    senses = holder.senses
    wrench = np.concatenate([-senses.mass * senses.gravity, np.zeros(3)])
    return balance_forces(
        points, inward, now.position, wrench, _FRICTION_SHARE * senses.friction, holder.preload
    )
