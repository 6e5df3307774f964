"""Bound every displacement and change nothing else."""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.raw import RawInterface

LIMIT = 0.0015
"""Largest displacement per axis and control step [m]: near the median of clean commands, so that it bites."""


class ClipInterface(RawInterface):
    """Clip the draft's displacement per axis, then execute it as it is. Satisfies `Interface`.

    Args:
        limit: Largest displacement per axis and control step [m].

    Raises:
        DexFlexError: If the limit is not positive.
    """

    name: str = "clip"

    def __init__(self, limit: float = LIMIT) -> None:
        super().__init__()
        if not limit > 0:
            raise DexFlexError(f"`limit` must be positive [m]. Got {limit}.")
        self._limit = limit

    def displacement(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the bounded displacement [m]. Shape (batch, 4, 3)."""
        return super().displacement(observation, draft).clamp(-self._limit, self._limit)
