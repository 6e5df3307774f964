"""Hands, observations and drafts for the tests of all interfaces."""

import torch

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces import Method

STATE, TACTILE = "observation.state", "observation.tactile"
BASELINES = ("joint", "raw", "filter", "hold", "shrink", "clip", "reflex")
LEARNED = ("dexgen", "dexflex", "dexflex-notouch")
METHODS = (*BASELINES, *LEARNED)
"""What every user may choose; evaluations register upper bounds beside them."""


def hand_poses(rows, seed=0):
    """Half-closed hands, well inside the joint limits."""
    generator = torch.Generator().manual_seed(seed)
    nominal = torch.tensor([0.8, 0.0, 0.5, 0.4] * 3 + [1.2, 0.2, 0.4, 0.4], dtype=torch.float64)
    return nominal + 0.1 * torch.randn(rows, 16, generator=generator, dtype=torch.float64)


def observation(rows, seed=0, arm=7):
    """Observations of hands that touch something with every finger."""
    joints = hand_poses(rows, seed)
    generator = torch.Generator().manual_seed(seed)
    return {
        STATE: torch.cat([torch.zeros(rows, arm, dtype=torch.float64), joints], 1),
        TACTILE: 0.1 * torch.rand(rows, 240, generator=generator),
        "observation.fingertips": fingertips(joints).flatten(1).float(),
        "observation.gravity": torch.tensor([0.0, 0.0, -1.0]).expand(rows, 3),
    }


def drafts(name, rows, seed=1, size=0.002):
    """Random drafts of the command space of an interface."""
    if Method.parse(name).command_space == "joint":
        return hand_poses(rows * DRAFT_HORIZON, seed).view(rows, DRAFT_HORIZON, 16)
    generator = torch.Generator().manual_seed(seed)
    return size * torch.randn(rows, DRAFT_HORIZON, 4, 3, generator=generator, dtype=torch.float64)


def row(observation, index):
    """One hand of a batch, still batched."""
    return {key: value[index : index + 1] for key, value in observation.items()}
