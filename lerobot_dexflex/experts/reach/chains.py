"""Chains of goals, the episodes of the in-hand benchmark.

`unverified` chains are the main ones: eight goals around the start pose, feasible by geometry, that nobody
has tried; what fails may be the goal's fault. For a `verified` chain the operator tries each goal from where
it came, once clean and once with a little noise, and then the whole: what fails later is the doing of the
command's errors or of the method under test, but easy objects are favoured.
"""

from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.hand_env import Snapshot
from lerobot_dexflex.envs.reach import ReachEnv, ReachEpisode
from lerobot_dexflex.experts.reach.goals import GoalDraws, Pose
from lerobot_dexflex.experts.reach.operator import Operator, OperatorState
from lerobot_dexflex.experts.reach.sensing import HandState, Senses
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.poses import pose_error

Array = NDArray[np.float64]

N_GOALS = 8
MAX_STEPS = 240
"""Time limit of a chain in control steps."""
TOLERANCE, STEADY_STEPS = (0.010, 0.25), 3
"""A goal is reached within [m] and [rad] for so many steps."""
_TRIES, _BUDGET = 4, 20
_VERIFY_STEPS = 40
_NOISE = 0.001
_LOST_STEPS, _LOST_DISTANCE = 5, 0.06
_GAIT_EVERY = 3


@dataclass(frozen=True)
class Goal:
    """One goal of a chain."""

    position: tuple[float, ...]
    """[m], palm frame."""
    quaternion: tuple[float, ...]
    """(w x y z)."""
    gait: bool
    """Whether the operator looks for a better place for one finger when this goal is set."""
    steps: int
    """Steps that the operator took; 0 if nobody tried."""

    @property
    def pose(self) -> Pose:
        """Position and orientation as arrays."""
        return np.array(self.position), np.array(self.quaternion)


@dataclass(frozen=True)
class Chain:
    """A start and the goals to visit from there; everything is decided by `seed`."""

    seed: int
    episode: ReachEpisode
    goals: tuple[Goal, ...]
    steps: int = MAX_STEPS
    """Control steps that the operator took for the whole with its own joint targets; the limit if it dropped
    the object or nobody has run it."""

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Inverse of `to_json`."""
        goals = tuple(
            Goal(tuple(g["position"]), tuple(g["quaternion"]), g["gait"], g["steps"]) for g in values["goals"]
        )
        return cls(values["seed"], ReachEpisode.from_dict(values["episode"]), goals, values["steps"])


class HeldObject:
    """One object in the hand with its operator.

    Args:
        env: A `ReachEnv` without cameras, which this begins anew.
        chain_seed: Seed of the start and of the operator's choices.
        episode: Where to start; drawn from the seed if None.
    """

    def __init__(self, env: ReachEnv, chain_seed: int, episode: ReachEpisode | None = None) -> None:
        self.env, self.seed = env, chain_seed
        self.observation = (
            env.reset(seed=chain_seed)[0] if episode is None else env.begin(episode, chain_seed)
        )
        self.senses = Senses(env)
        self.operator = Operator(self.senses, np.random.default_rng(chain_seed))
        self.home = env.object_pose[0]

    def set_goal(self, index: int, goal: Goal) -> None:
        """Give the operator the goal with this index in the chain."""
        self.operator.reseed((self.seed, index))
        self.operator.set_goal(*goal.pose)
        if goal.gait:
            self.operator.try_gait()

    def execute(self, joints: Array) -> HandState:
        """Execute joint targets [rad] (joints,) for one control step, return the state after it."""
        self.env.advance(joints)
        return self.senses.read()

    def snapshot(self) -> tuple[Snapshot, OperatorState]:
        """Return everything that decides the future."""
        return self.env.snapshot(), self.operator.state()

    def restore(self, snapshot: tuple[Snapshot, OperatorState]) -> None:
        """Return to a snapshot."""
        self.env.restore(snapshot[0])
        self.operator.set_state(snapshot[1])


def build_chain(env: ReachEnv, seed: int, verify: bool = True) -> Chain | None:
    """Return the chain of a seed, or None if its start does not have eight goals.

    Args:
        env: A `ReachEnv` without cameras.
        seed: Decides object, grasp, gravity and goals.
        verify: Whether the operator must reach the goals; if not, they are feasible by geometry.
    """
    held = HeldObject(env, seed)
    rng = np.random.default_rng((seed, 1))
    return _verified_chain(held, rng) if verify else _unverified_chain(held, rng)


def _unverified_chain(held: HeldObject, rng: np.random.Generator) -> Chain | None:
    """Return goals around the start, each apart from the one before; None if the grasp reaches too few."""
    draws, now = GoalDraws(held.operator, held.home), held.senses.read()
    start = previous = now.position, now.quaternion
    goals: list[Goal] = []
    for index in range(N_GOALS):
        pose, feasible = draws.draw(rng, now, start, previous)
        if not feasible:
            return None
        goals.append(_goal(pose, held.seed, index))
        previous = pose
    return Chain(held.seed, held.env.episode, tuple(goals))


def _verified_chain(held: HeldObject, rng: np.random.Generator) -> Chain | None:
    draws, goals = GoalDraws(held.operator, held.home), list[Goal]()
    nodes, tries = [held.snapshot()], [0]
    for _ in range(_BUDGET):
        if len(goals) == N_GOALS:
            break
        held.restore(nodes[-1])
        tries[-1] += 1
        if tries[-1] > _TRIES:
            if not goals:
                return None
            for stack in (nodes, tries, goals):
                stack.pop()
            continue
        now = held.senses.read()
        goal = _goal(draws.draw(rng, now, (now.position, now.quaternion)).pose, held.seed, len(goals))
        steps = _verified(held, goal, len(goals))
        if steps:
            goals.append(Goal(goal.position, goal.quaternion, goal.gait, steps))
            nodes.append(held.snapshot())
            tries.append(0)
    if len(goals) < N_GOALS:
        return None
    chain = Chain(held.seed, held.env.episode, tuple(goals))
    return chain if _completes(held.env, chain) else None


def _goal(pose: Pose, seed: int, index: int) -> Goal:
    gait = index > 0 and (seed + index) % _GAIT_EVERY == 0
    return Goal(tuple(map(float, pose[0])), tuple(map(float, pose[1])), gait, 0)


def _completes(env: ReachEnv, chain: Chain) -> bool:
    """Say whether the operator completes a chain in time."""
    held = HeldObject(env, chain.seed, chain.episode)
    steps = 0
    for index, goal in enumerate(chain.goals):
        taken = _attempt(held, goal, index, 0.0)
        steps += taken
        if not taken or steps > MAX_STEPS:
            return False
    return True


def _verified(held: HeldObject, goal: Goal, index: int) -> int:
    """Return the steps to the goal, or 0 if an attempt fails; ends where the clean attempt did."""
    start = held.snapshot()
    steps = _attempt(held, goal, index, 0.0)
    if not steps:
        return 0
    end = held.snapshot()
    held.restore(start)
    if not _attempt(held, goal, index, _NOISE):
        return 0
    held.restore(end)
    return steps


def _attempt(held: HeldObject, goal: Goal, index: int, noise: float) -> int:
    """Return the number of steps after which the goal is reached, or 0; noise is that of joints [rad]."""
    rng = np.random.default_rng((held.seed, index, 2))
    held.set_goal(index, goal)
    state = held.senses.read()
    steady = loose = 0
    for step in range(1, _VERIFY_STEPS + 1):
        joints = held.operator.guide(state).joints
        if noise:
            joints = joints + rng.uniform(-10 * noise, 10 * noise, len(joints))
        state = held.execute(joints)
        loose = 0 if (state.loads > CONTACT_FORCE).sum() >= 2 else loose + 1
        if loose >= _LOST_STEPS or np.linalg.norm(state.position - held.home) > _LOST_DISTANCE:
            return 0
        distance, angle = pose_error(state.position, state.quaternion, *goal.pose)
        steady = steady + 1 if distance < TOLERANCE[0] and angle < TOLERANCE[1] else 0
        if steady >= STEADY_STEPS:
            return step
    return 0
