"""What the tests of several tasks need."""

import gymnasium
import mujoco
import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.registration import NAMESPACE


def make_env(task: str, **options) -> HandEnv:
    """Make a task without its time limit."""
    env = gymnasium.make(f"{NAMESPACE}/{task}", **options).unwrapped
    assert isinstance(env, HandEnv)
    return env


def same(first, second) -> bool:
    """Say whether two observations, or what any number of steps returned, are equal bit for bit."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[key], second[key]) for key in first)
    if isinstance(first, list | tuple):
        return len(first) == len(second) and all(map(same, first, second))
    return np.array_equal(first, second)


def wiggle(env: HandEnv, steps: int, seed: int = 0):
    """Move all joints a little at random and return what each step returned."""
    rng = np.random.default_rng(seed)
    return [env.step(env.command + rng.normal(scale=0.01, size=len(env.joints))) for _ in range(steps)]


def wait(env: HandEnv, steps: int) -> dict:
    """Hold the command for some steps, or until the episode ends; return the last info."""
    info = {}
    for _ in range(steps):
        *_, done, _, info = env.step(env.command)
        if done:
            break
    return info


def place(env: HandEnv, body: str, position, rotation: np.ndarray | None = None) -> None:
    """Put a free body at rest at a pose in the world."""
    joint = env.data.joint(body)
    joint.qpos[:3], joint.qvel[:] = position, 0
    mujoco.mju_mat2Quat(joint.qpos[3:], (np.eye(3) if rotation is None else rotation).ravel())
