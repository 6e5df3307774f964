"""Execute fingertip displacements as they are, by inverse kinematics."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, check_draft
from lerobot_dexflex.interfaces.protocol import CommandSpace


class RawInterface(CommandedInterface):
    """Add the first displacement to the commanded fingertips and solve for joints. Satisfies `Interface`.

    The displacement moves the *commanded* fingertips: the squeeze lives in commanded minus measured, and a
    draft executed on measured fingertips lets go of the object.
    """

    name: str = "raw"
    command_space: CommandSpace = "draft"

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the draft's first displacement; see `Interface.step`."""
        return self.move(observation, self.displacement(observation, draft)).to(draft.dtype)

    def displacement(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the draft's first displacement, checked [m]. Shape (batch, 4, 3), float64."""
        rows = len(self.start(observation))
        return check_draft(draft, (4, 3), rows, "displacements of the four commanded fingertips [m]")[:, 0]
