"""What the tests of several tasks need."""

import gymnasium
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
