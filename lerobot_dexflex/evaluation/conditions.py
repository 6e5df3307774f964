"""Conditions of comparisons by name: what goes wrong with commands and world, who commands, which goals."""

from dataclasses import dataclass
from typing import Self

from lerobot_dexflex.commands.families import FAMILIES, NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.levels import LEVELS
from lerobot_dexflex.commands.source import Source
from lerobot_dexflex.envs.disturbance import DISTURBANCES
from lerobot_dexflex.errors import DexFlexError

CLEAN = "clean"
PRESSING, VERIFIED = "pressing", "verified"
IN_HAND = (PRESSING, VERIFIED)
"""Words that mean something in the in-hand benchmark only."""


@dataclass(frozen=True)
class Condition:
    """A condition; its name is words joined by `+`: errors, a disturbance, some of `IN_HAND`; or `clean`."""

    errors: CommandErrors = NO_ERRORS
    """What goes wrong with commands."""
    disturbance: str = "none"
    """A name of `envs.disturbance.DISTURBANCES`: what differs in the world."""
    source: Source = "motion"
    """What drafts say (in-hand benchmark)."""
    verified: bool = False
    """Whether the operator was seen to reach the goals (in-hand benchmark)."""

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the condition with this name.

        Raises:
            DexFlexError: If a word is unknown, or one of its kind is there already.
        """
        words = [word for word in name.split("+") if word != CLEAN]
        disturbances = [word for word in words if word in DISTURBANCES]
        errors = [word for word in words if word not in (*DISTURBANCES, *IN_HAND)]
        if strangers := [
            word for word in errors if word not in LEVELS and word.partition("_")[0] not in FAMILIES
        ]:
            families = (f"{family}_<strength>" for family in FAMILIES)
            known = (CLEAN, *DISTURBANCES, *IN_HAND, *LEVELS, *families)
            raise DexFlexError(
                f"Unknown word {strangers[0]!r} in the condition {name!r}. Valid, joined by `+`: "
                f"{', '.join(known)}."
            )
        if len(disturbances) > 1:
            raise DexFlexError(
                f"The condition {name!r} names {' and '.join(disturbances)}; at most one disturbance is "
                "possible."
            )
        return cls(
            CommandErrors.parse("+".join(errors)) if errors else NO_ERRORS,
            (disturbances or ["none"])[0],
            "pressing" if PRESSING in words else "motion",
            VERIFIED in words,
        )

    @property
    def name(self) -> str:
        """Canonical name; `parse` reads it."""
        return "+".join(word for word in (self.errors.name, *self.setting) if word != CLEAN) or CLEAN

    @property
    def setting(self) -> tuple[str, ...]:
        """The words of its name that are no errors."""
        words = (self.disturbance, PRESSING * (self.source == "pressing"), VERIFIED * self.verified)
        return tuple(word for word in words if word not in ("none", ""))
