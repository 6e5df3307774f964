"""What the tests of learned interfaces share: few candidates, decoders of known forces, hands that touch."""

import copy
from typing import Any

import torch
from interface_cases import STATE, TACTILE, drafts, observation

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface, ablated

FEW = {"n_pure": 4, "n_seeded": 4, "n_finger": 4, "nfe": 2, "include_draft": True, "hysteresis": 0.0}
_WORDS = "+".join(f"{key}={value}" for key, value in FEW.items())
LEARNED = [f"dexflex:{_WORDS}", f"dexflex-notouch:{_WORDS}", f"dexflex-nogrip:{_WORDS}", "dexgen:steps=2"]
"""Methods with networks, by name."""


def flex(controller, ablation="", **switches) -> Any:
    """The interface with few candidates."""
    return DexFlexInterface(LEAP, controller, ablated(SelectionSettings(**{**FEW, **switches}), ablation))


def draft_of(rows, seed=1, size=0.002):
    return drafts("dexflex", rows, seed, size)


def pressing(controller, newtons, touching=(True, True, True, True)):
    """A controller whose decoder always wants so many newtons along the pads' normals of some fingers."""
    found = copy.deepcopy(controller)
    out = torch.zeros(4, 4)
    out[:, 0] = -newtons / found.decoder.scale  # Pads look along -x of their links.
    out[:, 3] = torch.where(torch.tensor(touching), 9.0, -9.0)
    with torch.no_grad():
        found.decoder.out.weight.zero_()
        found.decoder.out.bias.copy_(out.flatten())
    return found


def touched(loads, rows=1, seed=0):
    """Hands whose fingers carry `loads` [N], a number for all or one per finger, all over their pads."""
    loads = torch.as_tensor(loads, dtype=torch.float32).expand(4)
    return {**observation(rows, seed), TACTILE: (loads[:, None] / 60).expand(rows, 4, 60).flatten(1)}


def joints_of(seen):
    return seen[STATE][:, -16:].double()


def tips_of(seen):
    return fingertips(LEAP, joints_of(seen))


def noisy(seen, k):
    """Add sensor noise, so that only a frozen finger repeats itself."""
    noise = 0.01 * torch.rand(seen[TACTILE].shape, generator=torch.Generator().manual_seed(100 + k))
    return {**seen, TACTILE: seen[TACTILE] + noise}
