"""What the tests of several tasks need."""

import numpy as np

from lerobot_dexflex.envs.hand_env import HandEnv


def same(first, second) -> bool:
    """Say whether two observations are equal, bit for bit."""
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[key], second[key]) for key in first)
    return np.array_equal(first, second)


def wiggle(env: HandEnv, steps: int, seed: int = 0):
    """Move all joints a little at random and return what each step returned."""
    rng = np.random.default_rng(seed)
    return [env.step(env.command + rng.normal(scale=0.01, size=23)) for _ in range(steps)]
