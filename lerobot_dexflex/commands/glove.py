"""A hand that is moved with a glove: what the person and the tracker get wrong, then an action interface."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.disturbed import DisturbedInterface
from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.source import Source
from lerobot_dexflex.commands.stream import Seed
from lerobot_dexflex.conventions import LEROBOT_KEYS, STATE
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hand.model import ARM_JOINTS
from lerobot_dexflex.interfaces.protocol import Interface

_ARM = len(ARM_JOINTS)


class GlovedHand:
    """A hand that follows an expert through a glove and an interface.

    An interface that reads drafts gets the expert's draft with the glove's errors; what it makes of them is
    executed and recorded, so a dataset's labels are what moved the hand. `joint` gets the expert's own
    joints: without errors they pass bit for bit, with errors they are moved as a policy's joint plans.

    Args:
        interface: Executes drafts, or joints.
        errors: Of the glove and of the person in it.
        seed: Of the errors and the person.
        source: What a draft says. `motion`: the squeeze is left out. `pressing`: it is in the draft, as hard
            as the person presses, or as the expert does without a level. `joint` reads no draft.
    """

    def __init__(
        self, interface: Interface, errors: CommandErrors, seed: Seed, source: Source = "motion"
    ) -> None:
        self._hand = interface.hand
        self._interface = DisturbedInterface(interface, errors, held=True)
        self._interface.reset()
        self._interface.begin([seed])
        self._source: Source = source

    @property
    def events(self) -> list[ErrorEvent]:
        """Events of the errors until now."""
        return self._interface.events

    def move(self, observation: Mapping[str, Any], command: Command) -> Command:
        """Return an expert's command as the hand gets it; the arm and its unsteadiness pass untouched.

        Args:
            observation: The environment's, of this step.
            command: Of an expert, who feels nothing of glove and interface but what the object does.
        """
        joint = self._interface.command_space == "joint"
        if joint and not self._interface.errors:
            return command
        state = {
            key: torch.as_tensor(np.asarray(observation[name], float))[None]
            for name, key in LEROBOT_KEYS.items()
        }
        here = fingertips(self._hand.tables, state[STATE][0, _ARM:].numpy())
        wanted = command.joint_targets[None, _ARM:] if joint else self._positions(command) - here
        hand = self._interface.step(state, torch.from_numpy(wanted)[None])[0].cpu().numpy()
        joints = np.concatenate([command.joint_targets[:_ARM], hand])
        return command._replace(
            joint_targets=joints, executed=joints + command.executed - command.joint_targets
        )

    def _positions(self, command: Command) -> NDArray[np.float64]:
        """Return where the person wants the fingertips, palm frame [m]. Shape (8, fingers, 3)."""
        if self._source == "motion":
            return command.draft
        [squeeze] = self._interface.squeeze([command.slipping])
        pressed = fingertips(self._hand.tables, command.joint_targets[_ARM:]) - command.draft[0]
        return command.draft + squeeze * pressed
