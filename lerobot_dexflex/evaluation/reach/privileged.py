"""Upper bounds: the operator's own joint targets, and its forces under a motion that somebody else chose."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from lerobot_dexflex.commands.loop import Slot
from lerobot_dexflex.conventions import TACTILE
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, check_draft
from lerobot_dexflex.interfaces.grip import NO_SERVO, Grip, centres_of_pressure, loads_of
from lerobot_dexflex.interfaces.raw import MEANING


class OperatorInterface(CommandedInterface):
    """Execute the operator's own joint targets, whatever the draft says. `Privileged`.

    Args:
        hand: The hand that it serves.
    """

    name: str = "operator"

    def __init__(self, hand: Hand) -> None:
        super().__init__(hand)
        self._slots: Sequence[Slot | None] = ()

    def see(self, slots: Sequence[Slot | None]) -> None:
        """Look at the running episodes; see `Privileged`."""
        self._slots = slots

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the operator's joint targets; see `Interface.step`."""
        measured = self._hand.look(observation)
        joints = measured.joints.clone()
        motion = torch.zeros_like(measured.tips)
        for k, slot in enumerate(self._slots):
            if slot is not None and slot.guidance is not None:
                joints[k] = torch.from_numpy(slot.guidance.joints)
                motion[k] = torch.from_numpy(slot.guidance.tips[0] - slot.state.tips)
        self._motion = motion
        return self._hand.execute(joints).to(draft.dtype)


class ForcesInterface(CommandedInterface):
    """Follow the draft with the operator's forces as grip: what a perfect decoder gives. `Privileged`.

    Args:
        hand: The hand that it serves.
    """

    name: str = "forces"

    def __init__(self, hand: Hand) -> None:
        super().__init__(hand)
        self._slots: Sequence[Slot | None] = ()
        self._grip = Grip(hand, NO_SERVO)

    def see(self, slots: Sequence[Slot | None]) -> None:
        """Look at the running episodes; see `Privileged`."""
        self._slots = slots

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        self._grip.reset(mask)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the draft's first step and the true grip; see `Interface.step`."""
        measured = self._hand.look(observation)
        checked = check_draft(draft, (self.hand.n_fingers, 3), len(measured.joints), MEANING)
        forces = torch.zeros_like(measured.tips)
        for k, slot in enumerate(self._slots):
            if slot is not None and slot.guidance is not None:
                forces[k] = torch.from_numpy(np.asarray(slot.guidance.forces))
        loads = loads_of(self.hand, observation[TACTILE]).double()
        self._grip.feel(loads)
        points = centres_of_pressure(self.hand, measured.joints, observation[TACTILE])
        torques, push = self._grip.exert(measured.joints, forces, loads, points)
        return self.move(measured, checked[:, 0], push, torques).to(draft.dtype)
