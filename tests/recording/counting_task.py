"""A task of nine steps without physics, so that the recording itself is what is tested."""

import contextlib
from collections.abc import Iterator

import gymnasium
import numpy as np
from gymnasium import spaces

from lerobot_dexflex import experts
from lerobot_dexflex.envs.registration import NAMESPACE, TASKS, TaskInfo
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import LEAP, Hand, get_hand
from lerobot_dexflex.recording import staging

STEPS = 9
FAILING_SEEDS = (2, 3)
TASK = "Count-v0"


class CountingEnv(gymnasium.Env):
    """Count the steps: every observation tells the seed and the step, some seeds fail."""

    metadata = {"render_modes": [], "render_fps": 20}  # noqa: RUF012

    def __init__(self, cameras: tuple[str, ...] = ("front", "wrist"), hand: str | Hand = LEAP) -> None:
        self._cameras = cameras
        self.hand = get_hand(hand) if isinstance(hand, str) else hand
        self.joints = robot_joints(self.hand)
        self.command = np.zeros(len(self.joints))
        self.pad_forces = 0.5 * np.arange(1, self.hand.n_fingers + 1)
        self.action_space = spaces.Box(-np.inf, np.inf, self.command.shape, np.float32)
        self.observation_space = spaces.Dict()
        self._seed = self._step = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._seed, self._step = int(seed or 0), 0
        return self._observe(), {"is_success": False, "progress": 0.0}

    def step(self, action):
        assert action.shape == self.command.shape
        self._step += 1
        success = self._step == STEPS and self._seed not in FAILING_SEEDS
        info = {"is_success": success, "progress": self._step / STEPS if success else 0.5}
        return self._observe(), 0.0, success, False, info

    def _observe(self):
        image = np.full((96, 96, 3), 10 * self._step + 5 * self._seed, np.uint8)
        pixels = {"pixels": dict.fromkeys(self._cameras, image)} if self._cameras else {}
        return pixels | {
            "agent_pos": np.full(len(self.joints), self._seed + self._step / 16, np.float32),
            "tactile": np.arange(self.hand.n_fingers * np.prod(self.hand.taxels), dtype=np.float32),
            "fingertips": np.full(3 * self.hand.n_fingers, self._step / 256, np.float32),
            "gravity": np.array([0, 0, -1], np.float32),
        }


def count(env: CountingEnv, rng: np.random.Generator) -> Iterator[Command]:
    """Send random joint targets and tips that name the step."""
    for k in range(STEPS):
        targets = rng.normal(size=len(env.joints))
        yield Command(targets, targets + 0.1, np.full((8, env.hand.n_fingers, 3), k / 128))


@contextlib.contextmanager
def counting(monkeypatch, *modules) -> Iterator[str]:
    """Make the task known, and its expert to these modules."""
    module = "lerobot_dexflex.envs.registration:"
    monkeypatch.setitem(TASKS, TASK, TaskInfo(module, 20, "Count to nine."))
    monkeypatch.setitem(experts._EXPERTS, TASK, "lerobot_dexflex.experts.command:Command")
    for module in modules:
        monkeypatch.setattr(module, "make_expert", lambda task: count)
    # The sources may be edited while tests run.
    monkeypatch.setattr(staging, "code_digest", lambda modules: "digest")
    gymnasium.register(
        f"{NAMESPACE}/{TASK}", entry_point=lambda **options: CountingEnv(**options), max_episode_steps=20
    )
    try:
        yield TASK
    finally:
        del gymnasium.registry[f"{NAMESPACE}/{TASK}"]
