"""Execute joint targets as they are, within the speed of the hand."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, check_draft
from lerobot_dexflex.interfaces.protocol import CommandSpace


class JointInterface(CommandedInterface):
    """The policy's joint targets go to the hand, no faster than it can turn. Satisfies `Interface`."""

    name: str = "joint"
    command_space: CommandSpace = "joint"

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the draft's first joint targets [rad], shape (batch, joints); see `Interface.step`."""
        with self.all_or_nothing():
            measured = self._hand.look(observation)
            shape, rows = (self.hand.n_joints,), len(measured.joints)
            checked = check_draft(draft, shape, rows, "absolute hand joint targets [rad]")
            joints = self._hand.execute(checked[:, 0])
        self._motion = fingertips(self.hand, joints) - measured.tips
        return joints.to(draft.dtype)
