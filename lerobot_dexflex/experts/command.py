"""What a scripted expert says at each control step, and how it turns fingertip targets into joints."""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips

Array = NDArray[np.float64]


class Command(NamedTuple):
    """One control step of an expert."""

    joint_targets: Array
    """What a student should do: absolute joint targets [rad]. Shape (23,)."""
    fingertips: Array
    """The commanded fingertips behind the hand's joint targets, palm frame [m]. Shape (4, 3)."""
    executed: Array
    """What the expert did: `joint_targets` plus its natural unsteadiness [rad]. Shape (23,)."""


class Expert(Protocol):
    """A privileged script: reads the simulator's state, yields commands until it is done."""

    def __call__(self, env: Any, rng: np.random.Generator) -> Iterator[Command]:
        """Yield the commands of the episode that `env` (unwrapped) has just been reset to."""
        ...


class FingertipExecutor:
    """Turn commanded fingertips into hand joints, each posture tied to the previous one.

    The same law as the `raw` interface: replaying the commanded fingertips gives the same joints.

    Args:
        hand_joints: Joint command at the start [rad]. Shape (16,).
    """

    def __init__(self, hand_joints: Array) -> None:
        self._joints = torch.as_tensor(np.asarray(hand_joints, float)).view(1, 16)

    @property
    def joints(self) -> Array:
        """The last joint command [rad]. Shape (16,)."""
        return self._joints[0].numpy().copy()

    def step(self, targets: Array) -> Array:
        """Return the joint command [rad] (16,) for fingertip targets in the palm frame [m] (4, 3)."""
        self._joints = solve_fingertips(torch.as_tensor(targets).view(1, 4, 3), self._joints)
        return self.joints


def fingertips_of(hand_joints: ArrayLike) -> Array:
    """Return the fingertips [m] (4, 3), palm frame, of hand joints [rad] (16,)."""
    return fingertips(torch.as_tensor(np.asarray(hand_joints, float)).view(1, 16))[0].numpy()


class Unsteadiness:
    """First-order autoregressive joint noise: smooth like a human hand, small against the task.

    Executing it while recording the steady command shows a student how to come back on track.

    Args:
        rng: Source of randomness.
        scale: Standard deviation of each joint [rad]. Shape (23,).
        correlation: Correlation of consecutive control steps.
    """

    def __init__(self, rng: np.random.Generator, scale: Array, correlation: float = 0.9) -> None:
        self._rng, self._scale, self._correlation = rng, scale, correlation
        self._value = np.zeros_like(scale)

    def step(self, share: float = 1.0) -> Array:
        """Return the next offset [rad] (23,), multiplied by `share`."""
        fresh = self._rng.normal(size=len(self._scale)) * np.sqrt(1 - self._correlation**2)
        self._value = self._correlation * self._value + fresh
        return share * self._scale * self._value


def min_jerk(phase: float) -> float:
    """Return the minimum-jerk position in [0, 1] at `phase` in [0, 1]."""
    return phase**3 * (10 - 15 * phase + 6 * phase**2)
