"""Configuration of `--env.type=dexflex`: the tasks of `lerobot_dexflex` for LeRobot's evaluation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from inspect import signature
from typing import Any

import gymnasium
from draccus.utils import ParsingError
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.envs.utils import freeze_after_episode_end
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

# Importing the registration here also registers the tasks in asynchronous workers, which import only this.
from lerobot_dexflex.envs.registration import NAMESPACE, TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand, get_hand
from lerobot_policy_dexflex.frame_index import FrameIndex

CAMERAS = ("front", "wrist")
IMAGE_SIZE = 96


@EnvConfig.register_subclass("dexflex")
@dataclass
class DexflexEnvConfig(EnvConfig):
    """A task of the tactile hand; the action is the absolute joint targets [rad]."""

    task: str | None = "PlaceHammer-v0"
    fps: int = 20
    episode_length: int | None = None
    """Time limit in control steps; the task's own if None."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further keyword arguments of the environment, e.g. '{"image_size": 128, "cameras": ["front"]}'."""
    hand: str = "leap"
    """The hand, by name."""
    action_size: int = 0
    """Numbers in the action of a policy whose post-processor makes joint targets of them
    (`dexflex_interface_processor`); 0 if the policy itself says joint targets."""
    features: dict[str, PolicyFeature] = field(default_factory=dict)
    features_map: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Fill in the features of the task's robot and of the cameras in `options`.

        Raises:
            ParsingError: If a setting is invalid. draccus hides the message of a ValueError, not of this.
        """
        if self.task not in TASKS:
            raise ParsingError(f"Unknown task {self.task!r}. Valid --env.task: {', '.join(TASKS)}.")
        if self.episode_length is not None and self.episode_length < 1:
            raise ParsingError(f"`episode_length` must be at least 1. Got {self.episode_length}.")
        size, names = self._observed_images()
        hand = self._find_hand()
        joints, tips = len(TASKS[self.task].joints(hand)), 3 * hand.n_fingers
        sizes = (joints, joints - hand.n_joints + tips, joints + tips)
        if self.action_size not in (0, *sizes):
            raise ParsingError(
                f"`action_size` of {self.task} must be {', '.join(map(str, sizes))} or 0. "
                f"Got {self.action_size}."
            )
        taxels = hand.n_fingers * math.prod(hand.taxels)
        vectors = {"agent_pos": joints, "tactile": taxels, "fingertips": tips, "gravity": 3}
        cameras = [f"{OBS_IMAGES}.{camera}" for camera in names]
        self.features = {
            ACTION: PolicyFeature(FeatureType.ACTION, (self.action_size or joints,)),
            **{key: PolicyFeature(FeatureType.STATE, (size,)) for key, size in vectors.items()},
            **{key: PolicyFeature(FeatureType.VISUAL, (size, size, 3)) for key in cameras},
        }
        self.features_map = {key: key for key in (ACTION, *cameras)} | {
            key: f"observation.{key}" for key in ("tactile", "fingertips", "gravity")
        }
        self.features_map["agent_pos"] = OBS_STATE

    def _find_hand(self) -> Hand:
        try:
            return get_hand(self.hand)
        except DexFlexError as error:
            raise ParsingError(f"--env.hand: {error}") from None

    def _observed_images(self) -> tuple[int, list[str]]:
        """Return size [pixel] and names of the cameras that `options` ask for."""
        cameras, size = self.options.get("cameras", CAMERAS), self.options.get("image_size", IMAGE_SIZE)
        if isinstance(cameras, str) or not isinstance(cameras, Sequence) or not set(cameras) <= set(CAMERAS):
            raise ParsingError(
                f"`cameras` in --env.options must be a list of {', '.join(CAMERAS)}. Got {cameras!r}."
            )
        if type(size) is not int or size < 1:
            raise ParsingError(f"`image_size` in --env.options must be a number of pixels. Got {size!r}.")
        valid = _option_names(TASKS[self.task or ""].entry_point) if self.options else []
        if unknown := sorted(set(self.options) - set(valid)):
            raise ParsingError(
                f"--env.options: {self.task} has no {', '.join(unknown)}. Valid options: {', '.join(valid)}."
            )
        return size, list(cameras)

    @property
    def package_name(self) -> str:
        """Namespace of the registered environments."""
        return NAMESPACE

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Keyword arguments of `gymnasium.make`."""
        limit = self.episode_length or TASKS[self.task or ""].max_episode_steps
        return {"render_mode": "rgb_array", "max_episode_steps": limit, "hand": self.hand, **self.options}

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


def _option_names(entry_point: str) -> list[str]:
    """Return the keyword arguments of an environment, its own and those that it hands to its bases."""
    module, name = entry_point.split(":")
    kind = getattr(import_module(module), name)
    inits = [signature(base.__init__) for base in kind.__mro__ if issubclass(base, gymnasium.Env)]
    names = {
        parameter.name
        for init in inits
        for parameter in init.parameters.values()
        if parameter.default != parameter.empty
    }
    return sorted(names - {"render_mode", "hand"})


def _make_env(config: DexflexEnvConfig) -> gymnasium.Env:
    def make() -> gymnasium.Env:
        return FrameIndex(
            gymnasium.make(config.gym_id, disable_env_checker=config.disable_env_checker, **config.gym_kwargs)
        )

    return freeze_after_episode_end(make)()
