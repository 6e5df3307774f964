"""Ignore drafts and hold: a lower bound that never drops what it holds and never gets anywhere."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.interfaces.raw import RawInterface


class HoldInterface(RawInterface):
    """Keep the commanded fingertips where they are. Satisfies `Interface`."""

    name: str = "hold"

    def displacement(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return no displacement at all; a wrong draft is refused nevertheless. Shape (batch, 4, 3)."""
        return 0.0 * super().displacement(observation, draft)
