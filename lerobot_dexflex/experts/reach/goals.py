"""Draw goal poses for the object that are feasible by geometry, for a grasp as it is."""

from typing import NamedTuple

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.experts.reach.fingers import Mode
from lerobot_dexflex.experts.reach.operator import Operator
from lerobot_dexflex.experts.reach.sensing import HandState
from lerobot_dexflex.hand.grasp import OBJECT
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.hand.poses import pose_error, quaternion_matrix, quaternion_of, quaternion_product

Array = NDArray[np.float64]
Pose = tuple[Array, Array]
"""Position [m] (3,) and orientation (w x y z)."""

DISTANCE, ANGLE = (0.012, 0.022), (0.28, 0.5)
"""How far a goal is from where it is drawn [m], [rad]."""
INSIDE = (0.010, 0.25)
"""Goals that only move, or only turn, the object stay below this in the other [m], [rad]."""
RADIUS = 0.03
"""Goals stay this close to where the episode began [m]."""
_CANDIDATES, _ROUNDS = 24, 3
_MAX_ERROR, _MARGIN = 0.003, 0.06
"""Fingertips come so near to their places on the object [m], their joints no nearer to their limits [rad]."""


class Draw(NamedTuple):
    """A goal, and whether it is feasible."""

    pose: Pose
    feasible: bool


def draw_goal(
    position: Array,
    quaternion: Array,
    rng: np.random.Generator,
    distance: tuple[float, float] = DISTANCE,
    angle: tuple[float, float] = ANGLE,
) -> Pose:
    """Return a goal pose that moves, turns, or moves and turns the object, a third of the time each."""
    direction, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    what = rng.integers(3)
    moved = rng.uniform(*distance) if what != 2 else rng.uniform(0, INSIDE[0])
    turned = rng.uniform(*angle) if what != 1 else rng.uniform(0, INSIDE[1])
    return position + moved * direction, quaternion_product(quaternion_of(turned * axis), quaternion)


class GoalDraws:
    """Draw goals for the grasp that an operator has now; nobody tries them.

    A goal is feasible if the holding fingertips reach their places on the object there, within their joints'
    ranges, and no link is in the object's way.

    Args:
        operator: Who holds the object.
        home: Where the object was first held [m]; goals stay within 3 cm of it. Shape (3,).
    """

    def __init__(self, operator: Operator, home: Array) -> None:
        self._operator, self._home, self._hand = operator, home, operator.senses.hand
        self._model = operator.senses.env.model
        self._data = mujoco.MjData(self._model)
        self._object = self._model.body(OBJECT).id
        self._distal = [self._model.body(name).id for name in self._hand.distal_links]

    def draw(
        self,
        rng: np.random.Generator,
        now: HandState,
        around: Pose,
        apart_from: Pose | None = None,
        rounds: int = _ROUNDS,
    ) -> Draw:
        """Return the first feasible goal, else the one that comes nearest to being feasible.

        Args:
            rng: Source of randomness.
            now: The state of the hand.
            around: From where goals are drawn.
            apart_from: A pose from which the goal shall be 12 mm or .28 rad away.
            rounds: So many times 24 goals are tried.
        """
        best: Pose | None = None
        least = np.inf
        for _ in range(rounds):
            goals = [draw_goal(*around, rng) for _ in range(_CANDIDATES)]
            joints, costs = self._reach(now, goals)
            for goal, posture, cost in zip(goals, joints, costs, strict=True):
                near = np.linalg.norm(goal[0] - self._home) <= RADIUS
                if apart_from is not None:
                    distance, angle = pose_error(*goal, *apart_from)
                    near = near and (distance > DISTANCE[0] or angle > ANGLE[0])
                if not near:
                    cost += 0.01
                if cost < _MAX_ERROR and self._blocked(posture, goal):
                    cost += 0.005
                if cost < least:
                    best, least = goal, cost
                if least < _MAX_ERROR:
                    break
            if least < _MAX_ERROR:
                break
        assert best is not None
        return Draw(best, bool(least < _MAX_ERROR))

    def _reach(self, now: HandState, goals: list[Pose]) -> tuple[Array, Array]:
        """Return postures at goals [rad] (goals, joints) and what they miss [m] (goals,)."""
        hand, fingers = self._hand, self._operator.fingers
        holding = fingers.mode == Mode.HOLD
        targets = np.stack([p + fingers.anchor @ quaternion_matrix(q).T for p, q in goals])
        targets[:, ~holding] = now.tips[~holding]
        wanted = torch.from_numpy(targets)
        start = torch.from_numpy(np.tile(now.joints, (len(goals), 1)))
        joints = solve_fingertips(hand, wanted, start, posture_weight=0.004, iterations=8)
        error = (wanted - fingertips(hand, joints)).norm(dim=-1).numpy()[:, holding].max(1, initial=0.0)
        solved, used = joints.numpy(), holding[hand.finger_of_joint]
        # A range that begins at zero ends at a stop, against which a straight finger rests.
        above = np.where(hand.joint_lower == 0.0, np.inf, solved - hand.joint_lower)
        margin = np.minimum(above, hand.joint_upper - solved)[:, used]
        short = np.maximum(0.0, _MARGIN - margin.min(1, initial=_MARGIN))
        return joints.numpy(), error + 0.05 * short

    def _blocked(self, joints: Array, goal: Pose) -> bool:
        """Say whether anything but a distal link touches the object there."""
        model, data = self._model, self._data
        pose = (*joints, *goal[0], *goal[1])
        data.qpos[: len(pose)] = pose
        mujoco.mj_fwdPosition(model, data)
        for contact in data.contact:
            bodies = model.geom_bodyid[contact.geom]
            if contact.dist < 0 and self._object in bodies and not np.isin(bodies, self._distal).any():
                return True
        return False
