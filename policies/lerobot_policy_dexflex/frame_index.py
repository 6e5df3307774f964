"""Number the control steps of an episode within its observations.

LeRobot's evaluation resets the policy but no processor (`rollout` in `lerobot_eval.py`), so that a processor
step with a memory cannot know that an episode begins; this tells it, row by row.
"""

from typing import Any

import gymnasium
import numpy as np

KEY = "frame_index"
"""As LeRobot's datasets call it. Shape (1,); 0 in an episode's first observation."""
FRAME_INDEX = f"observation.{KEY}"


class FrameIndex(gymnasium.Wrapper):
    """Adds `frame_index` to the observations of an environment.

    Args:
        env: Its observations are dictionaries.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        assert isinstance(env.observation_space, gymnasium.spaces.Dict)
        index = gymnasium.spaces.Box(0, np.iinfo(np.int64).max, (1,), np.int64)
        self.observation_space = gymnasium.spaces.Dict({**env.observation_space.spaces, KEY: index})
        self._index = 0

    def reset(self, **kwargs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode; see `gymnasium.Env.reset`."""
        observation, info = self.env.reset(**kwargs)
        self._index = 0
        return self._numbered(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Do one control step; see `gymnasium.Env.step`."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._index += 1
        return self._numbered(observation), reward, terminated, truncated, info

    def _numbered(self, observation: dict[str, Any]) -> dict[str, Any]:
        return {**observation, KEY: np.array([self._index])}
