"""What may go wrong with commands: one table of error families, and their names.

Sources: paper section 4.2 (noise, scale, delay, support-finger removal) and what gloves, trackers and
networks do. All numbers are per control step of 50 ms.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from lerobot_dexflex.commands.levels import LEVELS
from lerobot_dexflex.errors import DexFlexError

REMOVAL_STEPS = 8
"""Length of a removal [control steps]: as long as the operator's own lifts."""


class Onset(NamedTuple):
    """When events begin [control steps], upper ends excluded."""

    first: tuple[int, int] = (8, 20)
    """After the start of the episode."""
    next: tuple[int, int] = (17, 33)
    """After the onset of the one before if that lasts 8 steps; longer ones are followed by as long a rest."""


ONSET = Onset()


class Family(NamedTuple):
    """One way in which commands go wrong."""

    meaning: str
    strength: str
    """What the strength says, with its unit."""
    suffix: str = ""
    """Follows the number in a name."""
    unit: float = 1.0
    """SI value of 1 in a name."""
    onset: Onset | None = None
    """None: from the first step on."""
    duration: int | None = None
    """Length of an event [control steps]; None: the strength, or, without onset, the whole episode."""
    whole: bool = False
    """Whether the strength is a whole number."""
    least: float = 0.0
    """Smallest strength."""
    salt: tuple[int, ...] = ()
    """Tells a seed's random numbers of this family from those of others."""


_WIDTH = "half width of a uniform distribution on every fingertip coordinate [m]"
FAMILIES: dict[str, Family] = {
    "delay": Family("comes late", "by so many steps", whole=True, salt=(11,)),
    "scale": Family("is too large or too small", "factor of every motion", salt=(12,)),
    "bias": Family("is off by a constant", f"{_WIDTH}, drawn once", "mm", 1e-3, salt=(13,)),
    "noise": Family("is off by something else in every step", _WIDTH, "mm", 1e-3),
    "freeze": Family(
        "stands still now and then", "for so many steps", onset=ONSET, whole=True, least=1, salt=(15,)
    ),
    "dropout": Family(
        "loses a finger, drawn at random, which stands still",
        "for so many steps",
        onset=ONSET,
        whole=True,
        least=1,
        salt=(16,),
    ),
    "removal": Family(
        "sends the most loaded finger off the object now and then",
        "outward speed [m per step]",
        "mm",
        1e-3,
        onset=ONSET,
        duration=REMOVAL_STEPS,
        salt=(1,),
    ),
}
"""Every family by name, in the order in which joined ones act on a command."""
CLEAN = "clean"
"""Name of no error."""
_VALID = ", ".join(
    [*(f"{name}_<{f.suffix or ('steps' if f.whole else 'factor')}>" for name, f in FAMILIES.items()), *LEVELS]
)
LEVEL_SALT = (17,)
"""As `Family.salt`, of the person of a level."""


@dataclass(frozen=True)
class CommandError:
    """One error family and how strong it is.

    Raises:
        DexFlexError: If the family is unknown or the strength makes no sense.
    """

    family: str
    strength: float
    """See `Family.strength` of the table."""

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise DexFlexError(
                f"Unknown family of command errors {self.family!r}. Valid: {', '.join(FAMILIES)}."
            )
        row = FAMILIES[self.family]
        whole = not row.whole or float(self.strength).is_integer()
        if not (np.isfinite(self.strength) and self.strength >= row.least and whole):
            number = "a whole number, " if row.whole else ""
            raise DexFlexError(
                f"The strength of {self.family!r}, {row.strength}, must be {number}{row.least:g} or more. "
                f"Got {self.strength}."
            )

    @property
    def row(self) -> Family:
        """Its row of the table."""
        return FAMILIES[self.family]

    @property
    def steps(self) -> int:
        """Length of its events [control steps]; 0 if it has none."""
        if self.row.onset is None:
            return 0
        return int(self.strength) if self.row.duration is None else self.row.duration

    @property
    def name(self) -> str:
        """Name such as `noise_2mm`, `scale_1.5` or `freeze_8`."""
        return f"{self.family}_{round(self.strength / self.row.unit, 6):g}{self.row.suffix}"

    @classmethod
    def parse(cls, name: str) -> Self:
        """Inverse of `name`.

        Raises:
            DexFlexError: If the name is none.
        """
        family, _, number = name.partition("_")
        row = FAMILIES.get(family)
        if row is None or not number.endswith(row.suffix):
            raise DexFlexError(f"{name!r} is no command error. Valid: {_VALID}.")
        try:
            strength = float(number.removesuffix(row.suffix))
        except ValueError as error:
            raise DexFlexError(f"{name!r} is no command error. Valid: {_VALID}.") from error
        return cls(family, strength * row.unit)


@dataclass(frozen=True)
class CommandErrors:
    """Everything that goes wrong with a stream of commands; nothing by default.

    Raises:
        DexFlexError: If a family comes twice, or there is no such level.
    """

    errors: tuple[CommandError, ...] = ()
    """In the order of the table, whatever order they are given in."""
    level: str = ""
    """Of the person who commands, of `LEVELS`; empty: none."""

    def __post_init__(self) -> None:
        order = list(FAMILIES)
        found = tuple(sorted(self.errors, key=lambda error: order.index(error.family)))
        if len({error.family for error in found}) < len(found):
            names = "+".join(error.name for error in self.errors)
            raise DexFlexError(f"{names!r} names a family twice; join errors of different families.")
        if self.level and self.level not in LEVELS:
            raise DexFlexError(f"Unknown level {self.level!r}. Valid: {', '.join(LEVELS)}.")
        object.__setattr__(self, "errors", found)

    @classmethod
    def of(cls, **strengths: float) -> Self:
        """Return errors by their families' strengths: `CommandErrors.of(noise=0.004)`."""
        return cls(tuple(CommandError(family, strength) for family, strength in strengths.items()))

    @classmethod
    def parse(cls, name: str) -> Self:
        """Return the errors with this name: `clean`, `noise_2mm`, `noise_4mm+removal_2mm`, `typical`, ...

        Raises:
            DexFlexError: If a part of it is no command error, or it names two levels.
        """
        if name == CLEAN:
            return cls()
        words = name.split("+")
        levels = [word for word in words if word in LEVELS]
        if len(levels) > 1:
            raise DexFlexError(f"{name!r} names {' and '.join(levels)}; a person has one level.")
        families = tuple(CommandError.parse(word) for word in words if word not in LEVELS)
        return cls(families, "".join(levels))

    @property
    def name(self) -> str:
        """Name for tables; `parse` reads it."""
        return "+".join([self.level] * bool(self.level) + [error.name for error in self.errors]) or CLEAN

    @property
    def families(self) -> tuple[str, ...]:
        """Names of the families."""
        return tuple(error.family for error in self.errors)

    def __bool__(self) -> bool:
        return bool(self.errors or self.level)

    def __iter__(self) -> Iterator[CommandError]:
        return iter(self.errors)


NO_ERRORS = CommandErrors()
