"""Chains of goals that the operator is known to reach: the episodes of the degraded-command benchmark.

A goal joins a chain only if the operator reaches it with clean commands and in a copy with a little noise,
both from the same snapshot, and a chain only counts if the operator then completes it as a whole within the
time limit. What fails later is the doing of the command's corruption or of the method under test. Selection
by the operator's success favours easy objects: say so.
"""

from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.envs.hand_env import Snapshot
from lerobot_dexflex.envs.reach import ReachEnv, ReachEpisode
from lerobot_dexflex.experts.reach.goals import feasible_goal
from lerobot_dexflex.experts.reach.operator import Operator, OperatorState
from lerobot_dexflex.experts.reach.sensing import HandState, Senses
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.poses import pose_error

Array = NDArray[np.float64]

N_GOALS = 8
MAX_STEPS = 160
"""Time limit of a chain in control steps."""
TOLERANCE, STEADY_STEPS = (0.010, 0.25), 3
"""A goal is reached within [m] and [rad] for so many steps."""
_TRIES, _BUDGET = 4, 20
_VERIFY_STEPS, _NOISY_STEPS = 30, 40
_NOISE = 0.0015
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
    """Steps that the operator took with clean commands; 0 if nobody tried."""


@dataclass(frozen=True)
class Chain:
    """A start and the goals to visit from there; everything is decided by `seed`."""

    seed: int
    episode: ReachEpisode
    goals: tuple[Goal, ...]

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Self:
        """Inverse of `to_json`."""
        goals = tuple(
            Goal(tuple(g["position"]), tuple(g["quaternion"]), g["gait"], g["steps"]) for g in values["goals"]
        )
        return cls(values["seed"], ReachEpisode.from_dict(values["episode"]), goals)


class HeldObject:
    """One object in the hand with its operator, commanded by fingertip displacements.

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
        self.joints = env.command
        self.command = kernels.fingertips(self.joints)
        self.senses = Senses(env)
        self.operator = Operator(self.senses, np.random.default_rng(chain_seed))
        self.home = env.object_pose[0]

    def set_goal(self, index: int, goal: Goal) -> None:
        """Give the operator the goal with this index in the chain."""
        self.operator.reseed((self.seed, index))
        self.operator.set_goal(np.array(goal.position), np.array(goal.quaternion))
        if goal.gait:
            self.operator.try_gait()

    def execute(self, displacement: Array) -> HandState:
        """Displace the commanded fingertips [m] (4, 3), run one control step, return the state after it."""
        self.command = self.command + displacement
        self.joints = kernels.solve_fingertips(self.command, self.joints)
        self.env.advance(self.joints)
        return self.senses.read()

    def snapshot(self) -> tuple[Snapshot, OperatorState, Array, Array]:
        """Return everything that decides the future."""
        return self.env.snapshot(), self.operator.state(), self.command, self.joints

    def restore(self, snapshot: tuple[Snapshot, OperatorState, Array, Array]) -> None:
        """Return to a snapshot."""
        self.env.restore(snapshot[0])
        self.operator.set_state(snapshot[1])
        self.command, self.joints = snapshot[2], snapshot[3]


def build_chain(env: ReachEnv, seed: int, verify: bool = True) -> Chain | None:
    """Return the chain of a seed, or None if fewer than eight goals could be verified from its start.

    Args:
        env: A `ReachEnv` without cameras.
        seed: Decides object, grasp, gravity and goals.
        verify: Whether goals must be reached by the operator; if not, goals are only geometrically feasible,
            drawn from the start pose.
    """
    held = HeldObject(env, seed)
    rng = np.random.default_rng((seed, 1))
    if not verify:
        return Chain(seed, env.episode, tuple(_unverified(held, rng, k) for k in range(N_GOALS)))
    goals: list[Goal] = []
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
        goal = _draw(held, rng, len(goals))
        steps = _verified(held, goal, len(goals))
        if steps:
            goals.append(Goal(goal.position, goal.quaternion, goal.gait, steps))
            nodes.append(held.snapshot())
            tries.append(0)
    if len(goals) < N_GOALS:
        return None
    chain = Chain(seed, env.episode, tuple(goals))
    return chain if _completes(env, chain) else None


def _completes(env: ReachEnv, chain: Chain) -> bool:
    """Say whether the operator completes a chain in time."""
    held = HeldObject(env, chain.seed, chain.episode)
    steps = 0
    for index, goal in enumerate(chain.goals):
        taken = _attempt(held, goal, index, 0.0, _NOISY_STEPS)
        steps += taken
        if not taken or steps > MAX_STEPS:
            return False
    return True


def _unverified(held: HeldObject, rng: np.random.Generator, index: int) -> Goal:
    """Return a feasible goal as seen from the start; every second goal is the start pose itself."""
    if index % 2:
        return Goal(held.env.episode.position, held.env.episode.quaternion, False, 0)
    return _draw(held, rng, index)


def _draw(held: HeldObject, rng: np.random.Generator, index: int) -> Goal:
    position, quaternion = feasible_goal(held.operator.controller, rng, held.home)
    gait = index > 0 and (held.seed + index) % _GAIT_EVERY == 0
    return Goal(tuple(map(float, position)), tuple(map(float, quaternion)), gait, 0)


def _verified(held: HeldObject, goal: Goal, index: int) -> int:
    """Return the steps to the goal, or 0 if an attempt fails; ends where the clean attempt did."""
    start = held.snapshot()
    steps = _attempt(held, goal, index, 0.0, _VERIFY_STEPS)
    if not steps:
        return 0
    end = held.snapshot()
    held.restore(start)
    if not _attempt(held, goal, index, _NOISE, _NOISY_STEPS):
        return 0
    held.restore(end)
    return steps


def _attempt(held: HeldObject, goal: Goal, index: int, noise: float, limit: int) -> int:
    """Return the number of steps after which the goal is reached, or 0."""
    rng = np.random.default_rng((held.seed, index, 2))
    held.set_goal(index, goal)
    state = held.senses.read()
    steady = loose = 0
    for step in range(1, limit + 1):
        displacement = held.operator.displacement(held.command, state)
        if noise:
            displacement = displacement + rng.uniform(-noise, noise, (4, 3))
        state = held.execute(displacement)
        loose = 0 if (state.loads > CONTACT_FORCE).sum() >= 2 else loose + 1
        if loose >= _LOST_STEPS or np.linalg.norm(state.position - held.home) > _LOST_DISTANCE:
            return 0
        distance, angle = pose_error(
            state.position, state.quaternion, np.array(goal.position), np.array(goal.quaternion)
        )
        steady = steady + 1 if distance < TOLERANCE[0] and angle < TOLERANCE[1] else 0
        if steady >= STEADY_STEPS:
            return step
    return 0
