"""The conditions of the benchmark: how commands are degraded, and on which goals."""

from dataclasses import dataclass
from typing import Self

from lerobot_dexflex.commands.corruption import Corruption

UNVERIFIED = "_unverified"
PAPER_FAMILIES = ("noise", "scale", "delay", "removal")
"""The families that the paper's averages are taken over."""


@dataclass(frozen=True)
class Cell:
    """One condition."""

    corruption: Corruption
    verified: bool = True
    """Whether the operator was seen to reach the goals with clean commands."""

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the cell with this name: that of a corruption, perhaps followed by `_unverified`.

        Raises:
            DexFlexError: If the name is none.
        """
        return cls(Corruption.parse(name.removesuffix(UNVERIFIED)), not name.endswith(UNVERIFIED))

    @property
    def name(self) -> str:
        """Name for tables; `parse` reads it."""
        return self.corruption.name + ("" if self.verified else UNVERIFIED)

    @property
    def family(self) -> str | None:
        """The family over which this cell is averaged; None for what is no degradation or a control.

        Commands scaled below 1 are a control: the operator corrects the lag, and nothing is at stake.
        """
        family, strength = self.corruption.family, self.corruption.strength
        control = family == "scale" and strength <= 1
        return family if self.verified and family in PAPER_FAMILIES and not control else None
