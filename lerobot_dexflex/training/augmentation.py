"""Make the networks robust: hide touch and the slow token, disturb joints and fingertips."""

from dataclasses import dataclass

import torch

from lerobot_dexflex.controller.history import History


@dataclass
class AugmentationConfig:
    """How histories are disturbed in training."""

    touch_dropout: float = 0.15
    """Share of rows whose touch is hidden altogether."""
    finger_dropout: float = 0.1
    """Share of single fingers whose touch is hidden."""
    slow_dropout: float = 0.1
    """Share of rows whose slow token is hidden."""
    joint_noise: float = 0.002
    """Standard deviation of each joint's reading [rad]."""
    tip_noise: float = 0.0002
    """Standard deviation of each fingertip coordinate [m]."""


def augment(history: History, config: AugmentationConfig) -> History:
    """Return a disturbed copy, drawn from torch's global generator."""
    rows = len(history.joints)
    hidden = torch.rand(rows, 1) < config.touch_dropout
    hidden = hidden | (torch.rand(history.tactile_missing.shape) < config.finger_dropout)
    return history._replace(
        joints=history.joints + config.joint_noise * torch.randn_like(history.joints),
        fingertips=history.fingertips + config.tip_noise * torch.randn_like(history.fingertips),
        tactile_missing=history.tactile_missing | hidden,
        slow_missing=history.slow_missing | (torch.rand(rows) < config.slow_dropout),
    )
