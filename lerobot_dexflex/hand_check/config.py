"""What `dexflex-hand check` is told."""

from dataclasses import dataclass
from pathlib import Path

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import HANDS


@dataclass
class HandCheckConfig:
    """Check a hand: `dexflex-hand check leap`, or the name of another."""

    hand: str = ""
    """Name of the hand, or `package.module:ATTRIBUTE`; may stand after `check` without `--hand=`."""
    output: Path = Path("outputs/hand")
    """Folder for `hand.png`, which shows the hand with its pads and taxels, and the film."""
    film: bool = False
    """Also write `sweep.mp4`, in which one joint after another goes through its range."""

    def __post_init__(self) -> None:
        if not self.hand:
            raise DexFlexError(
                f"Which hand? Say `dexflex-hand check NAME` with one of {sorted(HANDS)}, or with a hand of "
                "your own as `package.module:ATTRIBUTE`."
            )
