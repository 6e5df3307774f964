"""Hands, observations and drafts for the tests of all interfaces."""

import math

import torch

from lerobot_dexflex.conventions import DRAFT_HORIZON, GRAVITY, STATE, TACTILE
from lerobot_dexflex.hand.kinematics import fingertips, joint_limits, pads
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import Method

METHODS = (
    *("joint", "raw", "raw@0.5", "press", "press:2.5+blocked=True+release=0.004+smoothing=0.4"),
    *("projection", "projection:preload=2@0.5", "filter", "filter:0.3+limit=0.01"),
)
"""Methods without networks."""


HALF_CLOSED = {
    "leap": [0.8, 0.0, 0.5, 0.4] * 3 + [1.2, 0.2, 0.4, 0.4],
    "sharpa": [0.6, 0.0, 0.6, 0.5] * 3 + [0.13, 0.6, 0.0, 0.6, 0.5] + [1.2, 0.0, 0.4, 0.0, 0.6],
}
"""Joints [rad], well inside the limits."""


def hand_poses(rows, seed=0, hand=LEAP):
    """Half-closed hands within the joint limits."""
    generator = torch.Generator().manual_seed(seed)
    middle = torch.tensor(HALF_CLOSED[hand.name], dtype=torch.float64)
    joints = middle + 0.1 * torch.randn(rows, hand.n_joints, generator=generator, dtype=torch.float64)
    return joints.clamp(*joint_limits(hand))


def observation(rows, seed=0, arm=7, hand=LEAP):
    """Observations of hands that touch something with every finger."""
    joints = hand_poses(rows, seed, hand)
    generator = torch.Generator().manual_seed(seed)
    return {
        STATE: torch.cat([torch.zeros(rows, arm, dtype=torch.float64), joints], 1),
        TACTILE: 0.1 * torch.rand(rows, taxels_of(hand), generator=generator),
        "observation.fingertips": fingertips(hand, joints).flatten(1).float(),
        GRAVITY: torch.tensor([0.0, 0.0, -1.0]).expand(rows, 3),
    }


def taxels_of(hand):
    """Return the number of all taxels of a hand."""
    return hand.n_fingers * math.prod(hand.taxels)


def touching(loads, rows=1, seed=0, hand=LEAP):
    """Hands whose fingers carry `loads` [N]: a number for all, or one per finger."""
    loads = torch.as_tensor(loads, dtype=torch.float32).expand(hand.n_fingers)
    each = math.prod(hand.taxels)
    taxels = (loads[:, None] / each).expand(rows, hand.n_fingers, each).flatten(1)
    return observation(rows, seed, hand=hand) | {TACTILE: taxels}


def measured(seen, hand=LEAP):
    """Return where the joints [rad], the fingertips and the pads' outward normals of the hands are."""
    joints = seen[STATE][:, -hand.n_joints :].double()
    return joints, fingertips(hand, joints), pads(hand, joints)[1]


def still(rows=1, hand=LEAP):
    """A draft to stay where the fingertips are measured."""
    return torch.zeros(rows, DRAFT_HORIZON, hand.n_fingers, 3, dtype=torch.float64)


def held(motion):
    """A draft that is after one step where it stays, as a glove's: (rows, 4, 3) [m]."""
    return motion[:, None].expand(-1, DRAFT_HORIZON, -1, -1)


def drafts(name, rows, seed=1, size=0.002, hand=LEAP):
    """Random drafts of the command space of an interface."""
    if Method.parse(name).command_space == "joint":
        return hand_poses(rows * DRAFT_HORIZON, seed, hand).view(rows, DRAFT_HORIZON, -1)
    generator = torch.Generator().manual_seed(seed)
    shape = rows, DRAFT_HORIZON, hand.n_fingers, 3
    return size * torch.randn(shape, generator=generator, dtype=torch.float64)


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
