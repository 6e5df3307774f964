"""Execute a fixed share of every displacement: the trivial cure for noise and delay.

It infers nothing; it lowers the gain of the loop that the operator closes. A method that claims to recover
intent has to be better than this, and than itself shrunk (`GainInterface`).
"""

from collections.abc import Mapping

from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.raw import RawInterface

GAIN = 0.5


class ShrinkInterface(RawInterface):
    """Displace the commanded fingertips by `gain` times the draft. Satisfies `Interface`.

    Args:
        gain: Share of the displacement that is executed, in (0, 1]; 1 is raw.

    Raises:
        DexFlexError: If the gain is outside.
    """

    name: str = "shrink"

    def __init__(self, gain: float = GAIN) -> None:
        super().__init__()
        if not 0 < gain <= 1:
            raise DexFlexError(f"`gain` must be in (0, 1]; 0 is the interface 'hold'. Got {gain}.")
        self._gain = gain

    def displacement(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the share of the draft's first displacement [m]. Shape (batch, 4, 3)."""
        return self._gain * super().displacement(observation, draft)
