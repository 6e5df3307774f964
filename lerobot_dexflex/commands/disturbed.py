"""Where command errors enter: between whoever drafts and the interface that executes."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.stream import ErrorStream, Seed, seeds_of
from lerobot_dexflex.conventions import STATE, TACTILE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, pads, solve_fingertips
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.interfaces.wrapper import WrappedInterface


class DisturbedInterface(WrappedInterface):
    """Spoils every draft on its way to an interface. Satisfies `Interface`; call `begin` before an episode.

    A delayed draft leads to the positions of an old one, and a removed finger leaves from where it is felt,
    so that it lets go at once however deep the squeeze was (its later steps go on outward: nobody knows when
    the removal ends). Planned joints are moved so that their fingertips are off by as much, by the inverse
    kinematics of `raw`.

    Args:
        inner: Any interface.
        errors: What goes wrong with the drafts.
        held: Whether drafts repeat their first step, as a glove's do; see `ErrorStream.step`.
    """

    def __init__(self, inner: Interface, errors: CommandErrors, held: bool = False) -> None:
        super().__init__(inner)
        self.errors, self._held = errors, held
        self._removes = "removal" in errors.families
        self._stream = ErrorStream(self.hand, 0)

    def begin(self, seeds: Sequence[Seed]) -> None:
        """Begin an episode per row, whose errors follow from its seed: the same for every interface."""
        self._stream = ErrorStream(self.hand, len(seeds))
        for row, seed in enumerate(seeds):
            self._stream.begin(row, self.errors, seeds_of(self.errors, seed))

    @property
    def in_event(self) -> NDArray[np.bool_]:
        """See `ErrorStream.in_event`."""
        return self._stream.in_event

    @property
    def events(self) -> list[ErrorEvent]:
        """See `ErrorStream.events`."""
        return self._stream.events

    def squeeze(self, slipping: Sequence[bool]) -> NDArray[np.float64]:
        """See `ErrorStream.squeeze`."""
        return self._stream.squeeze(slipping)

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all; without `begin`, errors are drawn on."""
        super().reset(mask)
        if len(self._stream):
            self._stream.restart(mask)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets for what arrives of the draft.

        Raises:
            DexFlexError: If `begin` was called for another number of hands, or removals lack touch; else as
                `Interface.step`.
        """
        if len(draft) != len(self._stream):
            raise DexFlexError(
                f"{self.errors.name!r} was begun for {len(self._stream)} hands, but {len(draft)} drafts "
                "came; call `begin` with a seed per hand before an episode."
            )
        spoil = self._joints if self.command_space == "joint" else self._motion
        return self.inner.step(observation, spoil(observation, draft.double()).to(draft.dtype))

    def _motion(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        joints = observation[STATE][:, -self.hand.n_joints :].double()
        tips = fingertips(self.hand, joints)
        here = tips[:, None]
        draft = self._stream.delayed(here + draft) - here
        return self._stream.step(draft, tips, *self._felt(observation, joints), held=self._held)

    def _joints(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        measured = observation[STATE][:, -self.hand.n_joints :].double()
        tips = fingertips(self.hand, measured)
        here = tips[:, None]
        draft = self._stream.delayed(draft)
        joints = draft.flatten(0, 1)
        # Shape (batch, steps, fingers, 3).
        motion = fingertips(self.hand, joints).unflatten(0, draft.shape[:2]) - here
        spoilt = self._stream.step(motion, tips, *self._felt(observation, measured), held=self._held)
        solved = solve_fingertips(self.hand, (here + spoilt).flatten(0, 1), joints).view_as(draft)
        struck = (spoilt != motion).flatten(3).any(-1).any(1)[:, None]  # (batch, 1, fingers)
        finger_of_joint = torch.tensor(self.hand.finger_of_joint, device=struck.device)
        return torch.where(struck.index_select(-1, finger_of_joint), solved, draft)

    def _felt(self, observation: Mapping[str, Tensor], joints: Tensor) -> tuple[Tensor, Tensor]:
        """Return loads [N], (batch, fingers), and inward normals, (batch, fingers, 3), for removals."""
        fingers = self.hand.n_fingers
        if not self._removes:
            return joints.new_zeros(len(joints), fingers), joints.new_zeros(len(joints), fingers, 3)
        if TACTILE not in observation:
            raise DexFlexError(f"{self.errors.name!r} needs touch: the observation lacks {TACTILE}.")
        loads = observation[TACTILE].double().unflatten(1, (fingers, -1)).sum(-1)
        return loads, pads(self.hand, joints)[1]
