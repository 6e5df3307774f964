"""Hands, observations and drafts for the tests of all interfaces."""

import torch

from lerobot_dexflex.conventions import DRAFT_HORIZON, GRAVITY, STATE, TACTILE
from lerobot_dexflex.hand.kinematics import fingertips, pads
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import Method

METHODS = (
    *("joint", "raw", "raw@0.5", "press", "press:2.5+blocked=True+release=0.004+smoothing=0.4"),
    *("projection", "projection:preload=2@0.5", "filter", "filter:0.3+limit=0.01"),
)
"""Methods without networks."""


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
        "observation.fingertips": fingertips(LEAP, joints).flatten(1).float(),
        GRAVITY: torch.tensor([0.0, 0.0, -1.0]).expand(rows, 3),
    }


def touching(loads, rows=1, seed=0):
    """Hands whose fingers carry `loads` [N]: a number for all, or one per finger."""
    loads = torch.as_tensor(loads, dtype=torch.float32).expand(4)
    taxels = (loads[:, None] / 60).expand(rows, 4, 60).flatten(1)
    return observation(rows, seed) | {TACTILE: taxels}


def measured(seen):
    """Return where the joints [rad], the fingertips and the pads' outward normals of the hands are."""
    joints = seen[STATE][:, -16:].double()
    return joints, fingertips(LEAP, joints), pads(LEAP, joints)[1]


def still(rows=1):
    """A draft to stay where the fingertips are measured."""
    return torch.zeros(rows, DRAFT_HORIZON, 4, 3, dtype=torch.float64)


def held(motion):
    """A draft that is after one step where it stays, as a glove's: (rows, 4, 3) [m]."""
    return motion[:, None].expand(-1, DRAFT_HORIZON, -1, -1)


def drafts(name, rows, seed=1, size=0.002):
    """Random drafts of the command space of an interface."""
    if Method.parse(name).command_space == "joint":
        return hand_poses(rows * DRAFT_HORIZON, seed).view(rows, DRAFT_HORIZON, 16)
    generator = torch.Generator().manual_seed(seed)
    return size * torch.randn(rows, DRAFT_HORIZON, 4, 3, generator=generator, dtype=torch.float64)


def row(observation, index):
    """One hand of a batch, still batched."""
    return {key: value[index : index + 1] for key, value in observation.items()}


def memory(interface):
    """Everything that an interface remembers, by name, its parts' memories included."""
    found = {}
    for name, value in vars(interface).items():
        inner = (
            vars(value)
            if type(value).__module__.startswith("lerobot_dexflex.interfaces") and hasattr(value, "__dict__")
            else {}
        )
        found |= {name: value} | {f"{name}.{key}": part for key, part in inner.items()}
    return found
