"""Draw goal poses for the object that the fingers holding it can follow."""

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.object_controller import Mode, ObjectController
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.hand.poses import quaternion_matrix, quaternion_of, quaternion_product

Array = NDArray[np.float64]

DISTANCE, ANGLE = (0.012, 0.022), (0.28, 0.5)
"""How far the next goal of a chain is away [m], [rad]."""
INSIDE = (0.010, 0.25)
"""Goals that only move, or only turn, the object stay below this in the other [m], [rad]."""
RADIUS = 0.03
"""Goals stay this close to where the episode began [m]."""
_CANDIDATES, _MAX_ERROR, _MARGIN = 24, 0.003, 0.03


def draw_goal(
    position: Array,
    quaternion: Array,
    rng: np.random.Generator,
    distance: tuple[float, float] = DISTANCE,
    angle: tuple[float, float] = ANGLE,
) -> tuple[Array, Array]:
    """Return a goal pose that moves, turns, or moves and turns the object, a third of the time each."""
    direction, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    what = rng.integers(3)
    moved = rng.uniform(*distance) if what != 2 else rng.uniform(0, INSIDE[0])
    turned = rng.uniform(*angle) if what != 1 else rng.uniform(0, INSIDE[1])
    return position + moved * direction, quaternion_product(quaternion_of(turned * axis), quaternion)


def feasible_goal(
    controller: ObjectController,
    rng: np.random.Generator,
    home: Array,
    distance: tuple[float, float] = DISTANCE,
    angle: tuple[float, float] = ANGLE,
) -> tuple[Array, Array]:
    """Return the first goal out of 24 that the holding fingers reach within 3 mm, else the best of them.

    Args:
        controller: Who holds the object.
        rng: Source of randomness.
        home: Where the object was first held [m]; goals stay within 3 cm of it. Shape (3,).
        distance: How far the goal is away [m].
        angle: How far it is turned [rad].
    """
    now, fingers = controller.senses.read(), controller.fingers
    goals = [draw_goal(now.position, now.quaternion, rng, distance, angle) for _ in range(_CANDIDATES)]
    far = np.array([np.linalg.norm(goal - home) > RADIUS for goal, _ in goals])
    holding = fingers.mode == Mode.HOLD
    targets = np.stack([p + fingers.anchor @ quaternion_matrix(q).T for p, q in goals])  # (goals, 4, 3)
    targets[:, ~holding] = now.tips[~holding]
    start = torch.from_numpy(np.broadcast_to(fingers.joints, (len(goals), 16)).copy())
    joints = solve_fingertips(torch.from_numpy(targets), start, posture_weight=0.004, iterations=8)
    error = (torch.from_numpy(targets) - fingertips(joints)).norm(dim=-1).numpy()[:, holding].max(1)
    solved = joints.numpy().reshape(-1, 4, 4)
    margin = np.minimum(solved - kernels.LOWER, kernels.UPPER - solved)[:, holding].min((1, 2))
    cost = error + 0.002 * (margin < _MARGIN) + 0.01 * far
    good = np.flatnonzero(cost < _MAX_ERROR)
    return goals[int(good[0]) if len(good) else int(cost.argmin())]
