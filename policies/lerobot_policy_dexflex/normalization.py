"""Bring observations to unit scale; the statistics travel in the checkpoint. Plans: `plan.py`."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from lerobot_dexflex.conventions import FINGERTIPS, STATE
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.protocol import CommandSpace

MIN_ANGLE_STD = 0.01
"""A joint that hardly moves in the data is not blown up to unit scale [rad]."""
MIN_LENGTH_STD = 0.002
"""The same for fingertips [m]."""


class Normalizer(nn.Module):
    """Shift and scale vectors of joint angles followed by fingertips.

    Every joint has its own standard deviation; every fingertip has one for all three axes, so that its
    geometry survives.

    Args:
        n_angles: Leading joint angles.
        n_tips: Trailing fingertips, three numbers each.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, n_angles: int, n_tips: int) -> None:
        super().__init__()
        self.n_angles, self.n_tips = n_angles, n_tips
        size = n_angles + 3 * n_tips
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def fit(self, mean: Tensor, std: Tensor) -> None:
        """Take over a dataset's statistics, each of shape (n_angles + 3 * n_tips,)."""
        angles = std[: self.n_angles].clamp(min=MIN_ANGLE_STD)
        tips = std[self.n_angles :].view(self.n_tips, 3).square().mean(1, keepdim=True).sqrt()
        tips = tips.clamp(min=MIN_LENGTH_STD).expand(-1, 3).flatten()
        self.mean.copy_(mean)
        self.std.copy_(torch.cat([angles, tips]))

    def forward(self, values: Tensor) -> Tensor:
        """Normalise values (..., n_angles + 3 * n_tips)."""
        return (values - self.mean) / self.std


class Normalization(nn.Module):
    """Normalizers of measured joints and fingertips.

    Args:
        hand: The hand.
        n_joints: Joints of the robot, arm and hand.
    """

    def __init__(self, hand: Hand, n_joints: int) -> None:
        super().__init__()
        self.state = Normalizer(n_joints, 0)
        self.fingertips = Normalizer(0, hand.n_fingers)

    def fit(self, stats: Mapping[str, Mapping[str, Any]]) -> None:
        """Take over LeRobot's dataset statistics (`mean` and `std` per feature)."""
        for normalizer, key in ((self.state, STATE), (self.fingertips, FINGERTIPS)):
            mean, std = (torch.as_tensor(stats[key][name], dtype=torch.float32) for name in ("mean", "std"))
            normalizer.fit(mean, std)


def tip_numbers(hand: Hand) -> int:
    """Return how many coordinates of fingertips follow the joint targets in a dataset's action."""
    return 3 * hand.n_fingers


def action_columns(hand: Hand, n_joints: int, command_space: CommandSpace) -> list[int]:
    """Return what an interface executes of a dataset's action: all joints, or arm joints and fingertips."""
    if command_space == "joint":
        return list(range(n_joints))
    return [*range(n_joints - hand.n_joints), *range(n_joints, n_joints + tip_numbers(hand))]


def action_sizes(hand: Hand, n_joints: int, command_space: CommandSpace = "draft") -> tuple[int, int]:
    """Return the sizes of an action: of what an interface executes, and of a dataset's whole action."""
    return len(action_columns(hand, n_joints, command_space)), n_joints + tip_numbers(hand)


def compress_touch(hand: Hand, taxels: Tensor, full_scale: float) -> Tensor:
    """Scale taxel forces [N] by a fixed full scale and take the root, which resolves light touch.

    Args:
        hand: The hand that feels.
        taxels: Shape (batch, fingers * taxels of a finger) [N].
        full_scale: Force that becomes 1 [N].

    Returns:
        Shape (batch, fingers, taxels of a finger), never negative.
    """
    return (taxels.clamp(min=0) / full_scale).sqrt().unflatten(-1, (hand.n_fingers, -1))
