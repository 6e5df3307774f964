"""What every action interface is: the one object between a policy's draft and the hand's joint targets."""

from collections.abc import Mapping
from typing import Literal, Protocol

from torch import Tensor

CommandSpace = Literal["joint", "draft"]
"""`joint`: drafts are absolute joint targets. `draft`: they are displacements of the commanded fingertips."""


class Interface(Protocol):
    """Turn a policy's draft into hand joint targets, once per control step, for a batch of hands.

    Observations are in raw units: `observation.state` (batch, 23) or (batch, 16) [rad], of which the last
    16 are the hand's, `observation.tactile` (batch, 240) [N], `observation.fingertips` (batch, 12) [m] and
    `observation.gravity` (batch, 3). An interface reads only the keys it needs.

    After a reset the previous joint command is the measured hand unless `start` is given another, and the
    commanded fingertips are where those joints put them.
    """

    name: str
    command_space: CommandSpace

    @property
    def command(self) -> Tensor | None:
        """Executed commanded fingertips in the palm frame [m], (batch, 4, 3); None before the first step."""
        ...

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, shape (batch,) bool; in all rows if it is None."""
        ...

    def start(self, observation: Mapping[str, Tensor], initial: Tensor | None = None) -> Tensor:
        """Return `command` before this step [m], (batch, 4, 3).

        Args:
            observation: The current observation of every row, raw units.
            initial: Joint command [rad], (batch, 16), from which the rows that were just reset begin; other
                rows ignore theirs. The measured joints by default, which let go of an object that the hand
                already squeezes.

        Raises:
            DexFlexError: If the observation or `initial` has a wrong shape, NaN or infinity.
        """
        ...

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Execute the first step of a draft.

        Args:
            observation: The current observation of every row, raw units.
            draft: Shape (batch, horizon, 16), joint targets [rad], or (batch, horizon, 4, 3), per-step
                displacements of the commanded fingertips in the palm frame [m], by `command_space`.

        Returns:
            Hand joint targets [rad], in the draft's dtype. Shape (batch, 16).

        Raises:
            DexFlexError: If the draft or observation has a wrong shape, NaN or infinity, or lacks a key, or
                if the batch size changes without a reset. Nothing is executed then.
        """
        ...
