"""Execute joint targets as they are."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces.commanded_hand import HAND_JOINTS, CommandedHand, check_draft
from lerobot_dexflex.interfaces.protocol import CommandSpace


class JointInterface:
    """The identity: the policy's joint targets go to the hand. Satisfies `Interface`."""

    name: str = "joint"
    command_space: CommandSpace = "joint"

    def __init__(self) -> None:
        self._hand = CommandedHand()

    @property
    def command(self) -> Tensor | None:
        """Commanded fingertips [m] of the last joint targets. Shape (batch, 4, 3)."""
        return self._hand.tips

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self._hand.reset(mask)

    def start(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return the commanded fingertips before this step [m]. Shape (batch, 4, 3)."""
        return self._hand.start(observation)[1]

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the draft's first joint targets [rad], shape (batch, 16); see `Interface.step`."""
        rows = len(self.start(observation))
        targets = check_draft(draft, (HAND_JOINTS,), rows, "absolute hand joint targets [rad]")[:, 0]
        self._hand.execute(targets, fingertips(targets))
        return draft[:, 0]
