"""A hand-written tactile reflex: a finger that carried load a moment ago keeps pressing."""

from collections.abc import Mapping

import torch
from torch import Tensor

from lerobot_dexflex.conventions import STATE, TACTILE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads
from lerobot_dexflex.interfaces.commanded_hand import N_JOINTS
from lerobot_dexflex.interfaces.raw import RawInterface
from lerobot_dexflex.interfaces.touch_watch import checked_taxels

LOADED = 0.1
"""A finger carries load from this sum of its taxels on [N], twice what counts as contact elsewhere: its
taxels are noisy."""
MEMORY = 6
"""Control steps for which a finger that lost its load goes on pressing."""
LEAD, LEAD_PER_NEWTON = 0.006, 0.004
"""The commanded tip stays so far inside of the measured one at 1 N [m], and further with less load [m/N]."""
LEAD_RANGE, LARGEST_LEAD = (0.002, 0.012), 0.015
CLIP = 0.004
"""Displacements are clipped per axis before the reflex [m]."""


class ReflexInterface(RawInterface):
    """Execute the clipped draft, but keep recently loaded fingers pressed inward. Satisfies `Interface`.

    The direction is that of the pad when it last carried load. The reflex knows nothing of intent: it also
    vetoes fingers that the operator lifts on purpose, and harms clean commands.
    """

    name: str = "reflex"

    def __init__(self) -> None:
        super().__init__()
        self._inward: Tensor | None = None
        self._age: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        if mask is None or self._age is None:
            self._inward = self._age = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._age.device)
        self._age = self._age.masked_fill(mask[:, None], MEMORY)

    def displacement(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the displacement that keeps contacts [m]. Shape (batch, 4, 3)."""
        asked = super().displacement(observation, draft).clamp(-CLIP, CLIP)
        command = self.start(observation)
        loads = _loads(observation, len(command)).to(command)  # (batch, 4)
        joints = observation[STATE][:, -N_JOINTS:].double()
        inward = self._remember(loads, pads(joints)[1])
        measured = fingertips(joints)
        lead = command + asked - measured
        along = (lead * inward).sum(-1, keepdim=True)  # (batch, 4, 1)
        least = (LEAD + LEAD_PER_NEWTON * (1.0 - loads)).clamp(*LEAD_RANGE)[..., None]
        pressed = lead + (along.clamp(min=least, max=torch.full_like(least, LARGEST_LEAD)) - along) * inward
        assert self._age is not None
        return torch.where((self._age < MEMORY)[..., None], measured + pressed - command, asked)

    def _remember(self, loads: Tensor, normals: Tensor) -> Tensor:
        """Return, per finger, the pad normal when it last carried load. Shape (batch, 4, 3)."""
        if self._inward is None or self._age is None:
            self._inward, self._age = normals, torch.full_like(loads, MEMORY)
        loaded = loads > LOADED
        self._inward = torch.where(loaded[..., None], normals, self._inward)
        self._age = torch.where(loaded, 0.0, self._age + 1)
        return self._inward


def _loads(observation: Mapping[str, Tensor], rows: int) -> Tensor:
    taxels = checked_taxels(observation, rows)
    if taxels is None:
        raise DexFlexError(
            f"The reflex needs touch: the observation lacks '{TACTILE}'. Use 'raw' without it."
        )
    return taxels.nan_to_num(0.0).sum(-1)
