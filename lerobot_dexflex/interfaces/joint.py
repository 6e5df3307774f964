"""Execute joint targets as they are."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces.commanded_hand import HAND_JOINTS, CommandedInterface, check_draft
from lerobot_dexflex.interfaces.protocol import CommandSpace


class JointInterface(CommandedInterface):
    """The identity: the policy's joint targets go to the hand. Satisfies `Interface`."""

    name: str = "joint"
    command_space: CommandSpace = "joint"

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the draft's first joint targets [rad], shape (batch, 16); see `Interface.step`."""
        rows = len(self.start(observation))
        targets = check_draft(draft, (HAND_JOINTS,), rows, "absolute hand joint targets [rad]")[:, 0]
        self._hand.execute(targets, fingertips(targets))
        return draft[:, 0]
