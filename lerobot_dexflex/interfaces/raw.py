"""Execute drafts as they are, by inverse kinematics."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, check_draft

MEANING = "where the fingertips should be, relative to where they are measured [m]"


class RawInterface(CommandedInterface):
    """Move the fingertips to where the draft's first step wants them. Satisfies `Interface`.

    It adds no grip. A draft that only says where the fingertips should be then lets go of what the hand
    holds; one that commands into the object presses by as much as its servo lags.
    """

    name: str = "raw"

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the draft's first step; see `Interface.step`."""
        with self.all_or_nothing():
            measured = self._hand.look(observation)
            checked = check_draft(draft, (self.hand.n_fingers, 3), len(measured.joints), MEANING)
            return self.move(measured, checked[:, 0]).to(draft.dtype)
