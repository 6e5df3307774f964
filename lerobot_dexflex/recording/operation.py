"""What stands between an operator's fingertips and the hand: a glove's jitter, then an action interface."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from lerobot_dexflex.conventions import DRAFT_HORIZON, LEROBOT_KEYS
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hand.model import ARM_JOINTS
from lerobot_dexflex.interfaces import Interface

_ARM = len(ARM_JOINTS)


class OperatedHand:
    """A hand that an operator moves with a glove, through an interface.

    The glove says where the fingertips should be and knows no future: a draft is the displacement that
    leads the command there, held over its horizon, as in `eval/degraded_commands.py`. What the interface
    makes of it is executed and recorded, so a dataset's labels are what moved the hand.

    Args:
        interface: Executes drafts.
        noise: Half width of uniform noise on every fingertip coordinate and step, the glove's jitter [m].
        rng: Source of the noise.
        hand_joints: Joint command at the start [rad]. Shape (16,).
    """

    def __init__(
        self, interface: Interface, noise: float, rng: np.random.Generator, hand_joints: ArrayLike
    ) -> None:
        interface.reset()
        self._interface, self._noise, self._rng = interface, noise, rng
        self._initial = torch.as_tensor(np.asarray(hand_joints, float))[None]

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
        start = self._interface.start(state, self._initial)
        wanted = command.fingertips + self._rng.uniform(-self._noise, self._noise, command.fingertips.shape)
        draft = (torch.as_tensor(wanted) - start).unsqueeze(1).expand(-1, DRAFT_HORIZON, -1, -1)
        hand = self._interface.step(state, draft)[0].numpy()
        tips = self._interface.command
        assert tips is not None
        joints = np.concatenate([command.joint_targets[:_ARM], hand])
        return Command(joints, tips[0].numpy().copy(), joints + command.executed - command.joint_targets)
