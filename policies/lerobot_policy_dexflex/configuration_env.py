"""Configuration of `--env.type=dexflex`: the tasks of `lerobot_dexflex` for LeRobot's evaluation."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium
from draccus.utils import ParsingError
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import freeze_after_episode_end
from lerobot.utils.constants import ACTION, OBS_STATE

# Importing the registration here also registers the tasks in asynchronous workers, which import only this.
from lerobot_dexflex.envs.registration import NAMESPACE, TASKS

IMAGE_SHAPE = (96, 96, 3)
_CAMERAS = ("front", "wrist")


@EnvConfig.register_subclass("dexflex")
@dataclass
class DexflexEnvConfig(EnvConfig):
    """A task of the tactile hand; the action is the absolute joint targets [rad]."""

    task: str | None = "PlaceHammer-v0"
    fps: int = 20
    episode_length: int | None = None
    """Time limit in control steps; the task's own if None."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further keyword arguments of the environment, e.g. '{"render_size": 128}'."""
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fill in the features of the task's robot.

        Raises:
            ParsingError: If a setting is invalid. draccus hides the message of a ValueError, not of this.
        """
        if self.task not in TASKS:
            raise ParsingError(f"Unknown task {self.task!r}. Valid --env.task: {', '.join(TASKS)}.")
        if self.episode_length is not None and self.episode_length < 1:
            raise ParsingError(f"`episode_length` must be at least 1. Got {self.episode_length}.")
        joints = TASKS[self.task].joints
        vectors = {"agent_pos": joints, "tactile": 240, "fingertips": 12, "gravity": 3}
        cameras = [f"observation.images.{camera}" for camera in _CAMERAS]
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, (joints,)),
            **{key: PolicyFeature(FeatureType.STATE, (size,)) for key, size in vectors.items()},
            **{key: PolicyFeature(FeatureType.VISUAL, IMAGE_SHAPE) for key in cameras},
        }
        self.features_map = {key: key for key in (ACTION, *cameras)} | {
            key: f"observation.{key}" for key in ("tactile", "fingertips", "gravity")
        }
        self.features_map["agent_pos"] = OBS_STATE

    @property
    def package_name(self) -> str:
        """Namespace of the registered environments."""
        return NAMESPACE

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of `gymnasium.make`."""
        limit = self.episode_length or TASKS[self.task or ""].max_episode_steps
        return {"render_mode": "rgb_array", "max_episode_steps": limit, **self.options}

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, VectorEnv]]:
        """Return the vectorised task, keyed as LeRobot wants it.

        Finished episodes freeze and are reset at the next rollout: LeRobot's default, resetting within the
        step, adds rewards of the next episode to the last.
        """
        make_one = partial(_make_env, self)
        factories = [make_one] * n_envs
        if use_async_envs and n_envs > 1:
            vector: VectorEnv = AsyncVectorEnv(
                factories, context="forkserver", autoreset_mode=AutoresetMode.NEXT_STEP
            )
        else:
            vector = SyncVectorEnv(factories, autoreset_mode=AutoresetMode.NEXT_STEP)
        return {self.type: {0: vector}}


def _make_env(config: DexflexEnvConfig) -> gymnasium.Env:
    def make() -> gymnasium.Env:
        return gymnasium.make(
            config.gym_id, disable_env_checker=config.disable_env_checker, **config.gym_kwargs
        )

    return freeze_after_episode_end(make)()
