"""Conditions of comparisons by name: what goes wrong with commands and world, and which goals are set."""

from dataclasses import dataclass
from typing import Self

from lerobot_dexflex.commands.families import FAMILIES, NO_ERRORS, CommandErrors
from lerobot_dexflex.envs.disturbance import DISTURBANCES
from lerobot_dexflex.errors import DexFlexError

CLEAN, UNVERIFIED = "clean", "unverified"


@dataclass(frozen=True)
class Condition:
    """One condition; its name is words joined by `+`: errors, a disturbance, `unverified`; or `clean`."""

    errors: CommandErrors = NO_ERRORS
    """What goes wrong with commands."""
    disturbance: str = "none"
    """A name of `envs.disturbance.DISTURBANCES`: what differs in the world."""
    verified: bool = True
    """Whether the operator was seen to reach the goals with clean commands (in-hand benchmark)."""

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the condition with this name.

        Raises:
            DexFlexError: If a word is unknown, or one of its kind is there already.
        """
        words = [word for word in name.split("+") if word != CLEAN]
        disturbances = [word for word in words if word in DISTURBANCES]
        errors = [word for word in words if word not in (*DISTURBANCES, UNVERIFIED)]
        if strangers := [word for word in errors if word.partition("_")[0] not in FAMILIES]:
            known = (CLEAN, *DISTURBANCES, UNVERIFIED, *(f"{family}_<strength>" for family in FAMILIES))
            raise DexFlexError(
                f"Unknown word {strangers[0]!r} in the condition {name!r}. Valid, joined by `+`: "
                f"{', '.join(known)}."
            )
        if len(disturbances) > 1:
            raise DexFlexError(
                f"The condition {name!r} names {' and '.join(disturbances)}; at most one disturbance is "
                "possible."
            )
        parsed = CommandErrors.parse("+".join(errors)) if errors else NO_ERRORS
        return cls(parsed, (disturbances or ["none"])[0], UNVERIFIED not in words)

    @property
    def name(self) -> str:
        """Canonical name; `parse` reads it."""
        words = [self.errors.name, self.disturbance, "" if self.verified else UNVERIFIED]
        return "+".join(word for word in words if word not in (CLEAN, "none", "")) or CLEAN
