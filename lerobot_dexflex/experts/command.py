"""What an expert says at each control step, and the pieces of its motion that every expert needs."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]


class Command(NamedTuple):
    """One control step of an expert."""

    joint_targets: Array
    """What a student should do: absolute joint targets, arm then hand [rad]. Shape (arm + hand,)."""
    executed: Array
    """What the expert did: `joint_targets` plus its natural unsteadiness [rad]. Shape (arm + hand,)."""
    draft: Array
    """Where the fingertips should get to in 1, 2, ... 8 control steps, palm frame [m]. Shape (8, fingers, 3).

    Motion only: where a finger presses, `joint_targets` lead it deeper.
    """
    slipping: bool = False
    """Whether the expert sees that a finger has lost the object."""


class Expert(Protocol):
    """A privileged script: reads the simulator's state, yields commands until it is done."""

    def __call__(self, env: Any, rng: np.random.Generator) -> Iterator[Command]:
        """Yield the commands of the episode that `env` (unwrapped) has just been reset to."""
        ...


def fingertips_of(hand: Hand, joints: ArrayLike) -> Array:
    """Return the fingertips [m] (fingers, 3), palm frame, of hand joints [rad] (joints,)."""
    return fingertips(hand, torch.as_tensor(np.asarray(joints, float))[None])[0].numpy()


class Unsteadiness:
    """First-order autoregressive joint noise: smooth like a human hand.

    Executing it while recording the steady command shows a student how to come back on track.

    Args:
        rng: Source of randomness.
        scale: Standard deviation of each joint [rad]. Shape (joints,).
        correlation: Correlation of consecutive control steps.
    """

    def __init__(self, rng: np.random.Generator, scale: Array, correlation: float = 0.95) -> None:
        self._rng, self._scale, self._correlation = rng, scale, correlation
        self._value = np.zeros_like(scale)

    def step(self) -> Array:
        """Return the next offset [rad] (joints,)."""
        fresh = self._rng.normal(size=len(self._scale)) * np.sqrt(1 - self._correlation**2)
        self._value = self._correlation * self._value + fresh
        return self._scale * self._value


def min_jerk(phase: float) -> float:
    """Return the minimum-jerk position in [0, 1] at `phase` in [0, 1]."""
    return phase**3 * (10 - 15 * phase + 6 * phase**2)
