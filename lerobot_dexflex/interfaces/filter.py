"""Smooth and bound drafts before they are executed: the classical remedy, blind to contact."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, check_draft
from lerobot_dexflex.interfaces.raw import MEANING

SHARE, LIMIT = 0.7, 0.03
"""Defaults of `FilterInterface`; the share was chosen on tuning seeds of tools, below a pressing `novice`."""


class FilterInterface(CommandedInterface):
    """Low-pass filter the commanded fingertips and clip how far they lead (paper, section 4.1, FILTER).

    It adds no grip, as `raw`. Satisfies `Interface`.

    Args:
        hand: The hand that it serves.
        share: How far the command goes toward the draft in a control step, in (0, 1]; 1 does not smooth.
        limit: How far the command may be from the measured fingertip [m].
    """

    name: str = "filter"

    def __init__(self, hand: Hand, share: float = SHARE, limit: float = LIMIT) -> None:
        if not 0 < share <= 1:
            raise DexFlexError(f"`share` of the filter must be in (0, 1]. Got {share}.")
        if limit <= 0:
            raise DexFlexError(f"`limit` of the filter must be positive [m]. Got {limit}.")
        super().__init__(hand)
        self.share, self.limit = share, limit

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the filtered command; see `Interface.step`."""
        with self.all_or_nothing():
            measured = self._hand.look(observation)
            checked = check_draft(draft, (self.hand.n_fingers, 3), len(measured.joints), MEANING)
            # What was commanded last; measured in new rows.
            before = fingertips(self.hand, self._hand.posture)
            wanted = measured.tips + checked[:, 0]
            lead = before + self.share * (wanted - before) - measured.tips
            lead = lead * (self.limit / lead.norm(dim=-1, keepdim=True).clamp(min=self.limit))
            return self.move(measured, lead).to(draft.dtype)
