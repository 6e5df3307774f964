"""Kind 0: the operator leads the object from goal to goal."""

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.corpus.episode import RunningEpisode
from lerobot_dexflex.envs.reach import DROP_STEPS, STEADY_STEPS, TOLERANCE
from lerobot_dexflex.experts.reach.goals import GoalDraws
from lerobot_dexflex.experts.reach.operator import Guidance, Operator
from lerobot_dexflex.hand.poses import pose_error

Array = NDArray[np.float64]

_GOAL_STEPS = 50
_GAIT_SHARE = 0.4
"""How often the operator moves a finger to a better place before it goes on."""
_REST_SHARE, _REST_STEPS = 0.2, (5, 50)
"""How often it only holds the object for a while."""


class GoalFollower:
    """Lead the object to random goals, one after the other; satisfies `Leader`.

    Args:
        run: The episode, its object held.
        rng: Source of randomness.
        steps: Control steps to lead.
        strength: Factor of the executed squeeze; what the operator wants stays the same.
    """

    def __init__(
        self, run: RunningEpisode, rng: np.random.Generator, steps: int, strength: float = 1.0
    ) -> None:
        self.operator, self._rng = Operator(run.senses, rng, strength), rng
        self._end = run.steps + steps
        self._home = run.now.position.copy()
        self.attempted = self.solved = 0
        self._steady = self._goal_steps = self._rest = 0
        self._set_goal(run)

    def guide(self, run: RunningEpisode) -> Guidance | None:
        """Return the operator's guidance; ends when the object is lost or the time is over."""
        if run.lost_steps >= DROP_STEPS or run.steps >= self._end:
            return None
        self._judge(run)
        return self.operator.guide(run.now)

    def _judge(self, run: RunningEpisode) -> None:
        if self._rest:
            self._rest -= 1
            if not self._rest:
                self._set_goal(run)
            return
        distance, angle = pose_error(run.now.position, run.now.quaternion, *self.operator.goal)
        inside = distance < TOLERANCE[0] and angle < TOLERANCE[1]
        self._steady = self._steady + 1 if inside else 0
        self._goal_steps += 1
        solved = self._steady >= STEADY_STEPS
        self.solved += solved
        if solved or self._goal_steps >= _GOAL_STEPS:
            if self._rng.random() < _REST_SHARE:
                self._rest = int(self._rng.integers(*_REST_STEPS))
                self.operator.set_goal(run.now.position, run.now.quaternion)
                return
            self._set_goal(run)
            if self._rng.random() < _GAIT_SHARE:
                self.operator.try_gait()

    def _set_goal(self, run: RunningEpisode) -> None:
        now = run.now
        draws = GoalDraws(self.operator, self._home)
        self.operator.set_goal(*draws.draw(self._rng, now, (now.position, now.quaternion), rounds=1).pose)
        self.attempted += 1
        self._steady = self._goal_steps = 0
