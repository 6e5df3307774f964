"""An upper bound: the operator's own clean commands, as if nothing went wrong with them."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from lerobot_dexflex.commands.loop import Slot
from lerobot_dexflex.interfaces.raw import RawInterface


class CleanInterface(RawInterface):
    """Execute what the operator commanded instead of the draft that arrives. `Privileged`."""

    name: str = "clean"

    def __init__(self) -> None:
        super().__init__()
        self._slots: Sequence[Slot | None] = ()

    def see(self, slots: Sequence[Slot | None]) -> None:
        """Look at the running episodes; see `Privileged`."""
        self._slots = slots

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the clean commands; see `Interface.step`."""
        clean = [np.zeros((4, 3)) if slot is None else slot.label for slot in self._slots]
        held = torch.from_numpy(np.stack(clean)).to(draft)[:, None].expand_as(draft)
        return super().step(observation, held)
