"""Kind 1: the operator moves the object from goal to goal while its commands are corrupted."""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.envs.reach import DROP_STEPS, STEADY_STEPS, TOLERANCE
from lerobot_dexflex.experts.reach.goals import feasible_goal
from lerobot_dexflex.experts.reach.operator import Operator
from lerobot_dexflex.hand.poses import pose_error

Array = NDArray[np.float64]

_GOAL_STEPS = 70
_GAIT_SHARE = 0.25
"""How often the operator moves a finger to a better place before it goes on."""


class GoalFollower:
    """Lead the object to random goals, one after the other; satisfies `Leader`.

    Args:
        run: The episode, its object held.
        rng: Source of randomness.
        steps: Control steps to lead.
    """

    def __init__(self, run: RunningEpisode, rng: np.random.Generator, steps: int) -> None:
        self._operator, self._rng = Operator(run.senses, rng), rng
        self._end = run.steps + steps
        self._home = run.now.position.copy()
        self.attempted = self.solved = 0
        self._steady = self._goal_steps = 0
        self._set_goal()

    def label(self, run: RunningEpisode) -> Array | None:
        """Return the operator's displacement; ends when the object is lost or the time is over."""
        if run.lost_steps >= DROP_STEPS or run.steps >= self._end:
            return None
        self._judge(run)
        return self._operator.displacement(run.command, run.now)

    def _judge(self, run: RunningEpisode) -> None:
        distance, angle = pose_error(run.now.position, run.now.quaternion, *self._operator.controller.goal)
        inside = distance < TOLERANCE[0] and angle < TOLERANCE[1]
        self._steady = self._steady + 1 if inside else 0
        self._goal_steps += 1
        solved = self._steady >= STEADY_STEPS
        self.solved += solved
        if solved or self._goal_steps >= _GOAL_STEPS:
            self._set_goal()
            if self._rng.random() < _GAIT_SHARE:
                self._operator.try_gait()

    def _set_goal(self) -> None:
        self._operator.set_goal(*feasible_goal(self._operator.controller, self._rng, self._home))
        self.attempted += 1
        self._steady = self._goal_steps = 0
