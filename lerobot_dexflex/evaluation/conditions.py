"""Conditions of comparisons by name: what goes wrong with commands and hand, and which goals are set."""

from dataclasses import dataclass
from typing import Self

from lerobot_dexflex.commands.corruption import Corruption
from lerobot_dexflex.envs.disturbance import DISTURBANCES
from lerobot_dexflex.errors import DexFlexError

UNVERIFIED = "unverified"


@dataclass(frozen=True)
class Condition:
    """One condition; its name is words joined by `+`, or `clean`."""

    errors: Corruption
    disturbance: str = "none"
    verified: bool = True
    """Whether the operator was seen to reach the goals with clean commands (in-hand benchmark)."""

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the condition with this name.

        Raises:
            DexFlexError: If a word is unknown or one of its kind is there already.
        """
        words = [word for word in name.split("+") if word != "clean"]
        disturbances = [word for word in words if word in DISTURBANCES]
        errors = [word for word in words if word not in (*DISTURBANCES, UNVERIFIED)]
        if len(disturbances) > 1 or len(errors) > 1:
            raise DexFlexError(f"{name!r} names more than one disturbance or error.")
        parsed = Corruption.parse(errors[0]) if errors else Corruption()
        return cls(parsed, (disturbances or ["none"])[0], UNVERIFIED not in words)

    @property
    def name(self) -> str:
        """Canonical name; `parse` reads it."""
        words = [self.errors.name, self.disturbance, "" if self.verified else UNVERIFIED]
        return "+".join(word for word in words if word not in ("clean", "none", "")) or "clean"
