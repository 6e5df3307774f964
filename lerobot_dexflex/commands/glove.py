"""A hand that is moved with a glove: what the glove and its tracker get wrong, then an action interface."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch

from lerobot_dexflex.commands.disturbed import DisturbedInterface
from lerobot_dexflex.commands.draws import ErrorEvent
from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.stream import Seed
from lerobot_dexflex.conventions import DRAFT_HORIZON, LEROBOT_KEYS, STATE
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hand.model import ARM_JOINTS
from lerobot_dexflex.interfaces.protocol import Interface

_ARM = len(ARM_JOINTS)


class GlovedHand:
    """A hand that follows an expert's fingertips through a glove and an interface.

    The glove says where the fingertips should be and knows no future: a draft leads from where they are
    measured to there, in every step of its horizon. Task experts command into the object: they press. What
    the interface makes of it is executed and recorded, so a dataset's labels are what moved the hand.

    Args:
        interface: Executes drafts.
        errors: Of the glove.
        seed: Of the errors.
    """

    def __init__(self, interface: Interface, errors: CommandErrors, seed: Seed) -> None:
        self._interface = DisturbedInterface(interface, errors, held=True)
        self._interface.reset()
        self._interface.begin([seed])

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
        state = {
            key: torch.as_tensor(np.asarray(observation[name], float))[None]
            for name, key in LEROBOT_KEYS.items()
        }
        wanted = torch.as_tensor(command.fingertips, dtype=torch.float64)
        here = torch.from_numpy(fingertips(state[STATE][0, -16:].numpy()))
        draft = (wanted - here)[None, None].expand(-1, DRAFT_HORIZON, -1, -1)
        hand = self._interface.step(state, draft)[0].cpu().numpy()
        joints = np.concatenate([command.joint_targets[:_ARM], hand])
        return Command(joints, fingertips(hand), joints + command.executed - command.joint_targets)
