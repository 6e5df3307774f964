"""What every action interface is: the one object between a policy's draft and the hand's joint targets."""

from collections.abc import Mapping
from typing import Literal, Protocol

from torch import Tensor

from lerobot_dexflex.hands import Hand

CommandSpace = Literal["joint", "draft"]
"""`joint`: drafts are absolute joint targets. `draft`: they say where the fingertips should be."""


class Interface(Protocol):
    """Turn a policy's draft into hand joint targets, once per control step, for a batch of hands of one kind.

    Observations are in raw units: `observation.state` (batch, >= joints) [rad], of which the last are the
    hand's, `observation.tactile` (batch, fingers x taxels) [N] and `observation.gravity` (batch, 3). An
    interface reads only the keys it needs; where the fingertips are follows from the joints.

    A draft says for each of the next control steps where every fingertip should be, relative to where it is
    measured now (design section 2; paper section 3.1). It holds no force: how hard to press is the
    interface's business. Nothing has to be told to an interface before the first step.
    """

    hand: Hand
    """The hand that it serves."""
    name: str
    command_space: CommandSpace

    @property
    def motion(self) -> Tensor | None:
        """Motion of the fingertips that the last step asked of the hand, beside any grip.

        From where they were measured, in the palm frame [m], (batch, fingers, 3); None before the first step.
        """
        ...

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, shape (batch,) bool; in all rows if it is None."""
        ...

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Execute the first step of a draft.

        Args:
            observation: The current observation of every row, raw units.
            draft: By `command_space`: (batch, horizon, joints), joint targets [rad], or (batch, horizon,
                fingers, 3), where the fingertips should be after 1, 2, ... control steps, minus where they
                are measured now, in the palm frame [m].

        Returns:
            Hand joint targets [rad], in the draft's dtype. Shape (batch, joints).

        Raises:
            DexFlexError: If the draft or observation has a wrong shape, NaN or infinity, or lacks a key, or
                if the batch size changes without a reset. Nothing is executed then.
        """
        ...
