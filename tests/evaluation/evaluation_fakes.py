"""A tiny environment and policies whose outcomes are known by hand."""

from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.hands import LEAP, Hand
from lerobot_dexflex.runs.provenance import Version

NAMESPACE, TASKS = "dexflex_fake", ("Count-v0", "Recount-v0")
ENV_ID = f"{NAMESPACE}/{TASKS[0]}"


class CountEnv(gymnasium.Env):
    """Progress grows by the first action's value / 10; 1.0 is success, a negative action drops the object."""

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["rgb_array"],
        "render_fps": 20,
    }
    task_description = "count"
    seeing = True
    observation_space = spaces.Dict(
        {
            "pixels": spaces.Dict({"front": spaces.Box(0, 255, (96, 96, 3), np.uint8)}),
            "agent_pos": spaces.Box(-10, 10, (2,), np.float32),
            "tactile": spaces.Box(0, 10, (240,), np.float32),
            "fingertips": spaces.Box(-1, 1, (12,), np.float32),
        }
    )
    action_space = spaces.Box(-10, 10, (2,), np.float32)

    def __init__(self, render_mode=None, cameras=("front",), disturbance="none", hand=LEAP):
        self.hand = hand
        self.render_mode, self.disturbance = render_mode, disturbance

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.value, self.start = 0.0, float(self.np_random.random())
        return self._observe(), self._info(dropped=False)

    def step(self, action):
        weight = 4 if self.disturbance == "heavy" else 1
        self.value = min(1.0, self.value + float(action[0]) / 10 / weight)
        info = self._info(dropped=action[0] < 0)
        return self._observe(), 0.0, info["is_success"] or info["dropped"], False, info

    def render(self):
        return np.full((96, 96, 3), int(200 * abs(self.value)), np.uint8)

    def _observe(self):
        position = np.array([self.start, self.value], np.float32)
        tips, taxels = np.zeros(12, np.float32), np.zeros(240, np.float32)
        return {
            "pixels": {"front": self.render()},
            "agent_pos": position,
            "tactile": taxels,
            "fingertips": tips,
        }

    def _info(self, dropped):
        return {
            "is_success": self.value >= 1 - 1e-9,
            "progress": self.value,
            "dropped": bool(dropped),
            "holding": self.value < 0.5,
            "contacts": np.array([self.value > 0.3, True, False, False, False]),
        }


def register():
    for task in TASKS:
        if f"{NAMESPACE}/{task}" not in gymnasium.registry:
            entry = "evaluation_fakes:CountEnv"
            gymnasium.register(f"{NAMESPACE}/{task}", entry_point=entry, max_episode_steps=8)


class FakeController:
    """`good` advances by noise in [1, 3]; `lucky` drops the object in odd seeds; `still` does nothing."""

    def __init__(self, interface):
        self.interface, self.motion = interface, None

    def reset(self, seeds):
        self.seeds, self.rngs = seeds, [np.random.default_rng(seed) for seed in seeds]

    def act(self, observation, task):
        assert observation["pixels"]["front"].shape == (len(self.seeds), 96, 96, 3)
        assert task == "count"
        draft = np.full((len(self.seeds), 4, 3), 0.001)
        scale = {"good": 1.0, "lucky": 0.5, "still": 0.0}[self.interface]
        self.motion = Motion(draft, scale * draft)
        speeds = np.array([rng.uniform(1, 3) for rng in self.rngs])
        if self.interface == "lucky":
            speeds = np.where(np.array(self.seeds) % 2 == 1, -1.0, speeds)
        elif self.interface == "still":
            speeds = 0 * speeds
        return np.stack([speeds, observation["agent_pos"][:, 0]], axis=1)


@dataclass(frozen=True)
class FakePlayers:
    weights: tuple[tuple[str, str], ...] = ()
    """Of methods that are not `a`."""
    hand: Hand = LEAP

    def __call__(self, method, errors):
        return FakeController(method)

    def check(self, methods):
        if strangers := set(methods) - {"good", "lucky", "still"}:
            raise DexFlexError(f"No {strangers}.")

    def version(self, method, task, **settings):
        return Version("code", dict(self.weights).get(method, "a"), f"{method} {task} {settings}")


# Worker processes import this module to unpickle the policies, and so know the environment too.
register()
