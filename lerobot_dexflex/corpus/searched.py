"""Kinds 0 and 4: a backtracking search over what the operator could do, in short pieces, from goal to goal.

The operator alone may lose the object. The search lets it try a piece, goes back where that fails, and tries
it slower and firmer, after a regrasp, or moving and turning one after the other. What is kept is one
consistent episode without failures; the pieces that lost the object are kept as failures.
"""

from collections.abc import Generator, Iterator
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.episode import Bookmark, RunningEpisode
from lerobot_dexflex.corpus.schema import SEARCH
from lerobot_dexflex.corpus.shard import Shard
from lerobot_dexflex.corpus.world import World
from lerobot_dexflex.envs.reach import STEADY_STEPS, TOLERANCE, ReachEpisode
from lerobot_dexflex.experts.reach.goals import feasible_goal
from lerobot_dexflex.experts.reach.operator import Operator, OperatorState
from lerobot_dexflex.hand.poses import pose_error

Array = NDArray[np.float64]

_PIECE, _GAIT_PIECE = 12, 30
"""Control steps of a piece, and of one that begins with a regrasp."""
_BUDGET = 16
"""Pieces to try per goal."""
_EPISODE_STEPS = (80, 200)
_GIVE_UP = 2
"""The episode ends after so many unsolved goals in a row."""
_MAX_LOST, _MAX_SETBACK = 3, 1.5
"""A piece fails after so many steps with a lost object, or if the error grew by this, in tolerances."""
_CONTEXT = 8
"""Rows before a failed piece that are kept with it, for its history."""
_MAX_BRANCHES = 4
"""Failed pieces that are kept of an episode; hard objects would fill the corpus with theirs."""
_GAIT_FIRST = 0.2
_SLOW, _FIRM = 0.5, 1.4


class _Option(IntEnum):
    GO = 0
    SLOW = 1
    GAIT = 2
    MOVE = 3
    TURN = 4


class _Node(NamedTuple):
    mark: Bookmark
    operator: OperatorState
    steady: int
    options: list[_Option]


def search_episode(
    env: CorpusEnv, episode: ReachEpisode, world: World, rng: np.random.Generator, facts: dict[str, Any]
) -> Iterator[Shard]:
    """Yield failed branches as they come up and at last the episode without them.

    Args:
        env: Where it runs.
        episode: Object, gravity and grasp.
        world: Servos and sensors.
        rng: Source of randomness.
        facts: What else the metadata shall say.
    """
    search = Search(RunningEpisode(env, episode, world, SEARCH, facts), rng)
    limit, failures = int(rng.integers(*_EPISODE_STEPS)), 0
    while search.run.steps < limit and failures < _GIVE_UP:
        reached = yield from search.reach_a_goal()
        failures = 0 if reached else failures + 1
    facts |= {"goals_attempted": search.attempted, "goals_solved": search.solved}
    totals = {"goals_attempted": search.attempted, "goals_solved": search.solved}
    totals["steps_simulated_by_the_search"] = search.simulated
    if search.run.steps:
        yield search.run.finish()._replace(totals=totals)


class Search:
    """Depth-first search over pieces of the operator's work.

    Args:
        run: The episode, its object held; it grows by the pieces that succeed.
        rng: Source of randomness.
    """

    def __init__(self, run: RunningEpisode, rng: np.random.Generator) -> None:
        self.run, self._rng = run, rng
        self._operator = Operator(run.senses, rng)
        controller = self._operator.controller
        self._speed, self._preload = controller.speed, controller.preload
        self._home = run.now.position.copy()
        self._goal = run.now.position, run.now.quaternion
        self._steady = 0
        self.attempted = self.solved = self.simulated = 0
        self._branches = 0

    def reach_a_goal(self) -> Generator[Shard, None, bool]:
        """Search for the way to a new goal and yield failures on the way; return whether it was reached.

        The episode then ends at the goal, or where it was before.
        """
        self._goal = feasible_goal(self._operator.controller, self._rng, self._home)
        self._steady = 0
        self.attempted += 1
        root = self._node()
        nodes = [root]
        for _ in range(_BUDGET):
            while nodes and not nodes[-1].options:
                nodes.pop()
            if not nodes:
                break
            node = nodes[-1]
            self._return_to(node)
            if self._try(node.options.pop(0)):
                if self._steady >= STEADY_STEPS:
                    self.solved += 1
                    return True
                nodes.append(self._node())
            elif self.run.lost_steps >= _MAX_LOST and self._branches < _MAX_BRANCHES:
                self._branches += 1
                yield self.run.failure(max(0, node.mark.rows - _CONTEXT))
        self._return_to(root)
        return False

    def _try(self, option: _Option) -> bool:
        """Run one piece; return whether it is worth going on from there."""
        run, operator = self.run, self._operator
        start = self._error()
        position, quaternion = self._goal
        if option == _Option.MOVE:
            quaternion = run.now.quaternion
        elif option == _Option.TURN:
            position = run.now.position
        controller, slow = operator.controller, option == _Option.SLOW
        pace = _SLOW if slow else 1.0
        controller.speed = pace * self._speed[0], pace * self._speed[1]
        controller.preload = self._preload * (_FIRM if slow else 1.0)
        operator.set_goal(position, quaternion)
        if option == _Option.GAIT and not operator.try_gait():
            return False
        for _ in range(_GAIT_PIECE if option == _Option.GAIT else _PIECE):
            label = operator.displacement(run.command, run.now)
            run.step(label, label)
            self.simulated += 1
            distance, angle = pose_error(run.now.position, run.now.quaternion, *self._goal)
            self._steady = self._steady + 1 if distance < TOLERANCE[0] and angle < TOLERANCE[1] else 0
            if run.lost_steps >= _MAX_LOST:
                return False
            if self._steady >= STEADY_STEPS:
                return True
        return not run.lost_steps and self._error() < start + _MAX_SETBACK

    def _node(self) -> _Node:
        # Two regrasps: each draws another finger and place.
        others = self._rng.permutation([_Option.SLOW, *2 * [_Option.GAIT], _Option.MOVE, _Option.TURN])
        options = [_Option.GO, *map(_Option, others)]
        if self._rng.random() < _GAIT_FIRST:
            options.insert(0, _Option.GAIT)
        return _Node(self.run.bookmark(), self._operator.state(), self._steady, options)

    def _return_to(self, node: _Node) -> None:
        self.run.go_back(node.mark)
        self._operator.set_state(node.operator)
        self._steady = node.steady

    def _error(self) -> float:
        distance, angle = pose_error(self.run.now.position, self.run.now.quaternion, *self._goal)
        return distance / TOLERANCE[0] + angle / TOLERANCE[1]
