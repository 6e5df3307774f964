"""What the drafts of whoever commands say: a motion, or a motion that presses."""

from typing import Literal, get_args

from lerobot_dexflex.errors import DexFlexError

Source = Literal["motion", "pressing"]
"""What a draft says. `motion`: where the fingertips should be. `pressing`: it commands into the object, by a
factor of what a position servo needs for the operator's grip."""
SOURCES: tuple[Source, ...] = get_args(Source)


def operator_label(source: Source) -> str:
    """Return what tells an operator's rows in a table by what the drafts say."""
    return "operator" if source == "motion" else f"operator-{source}"


def check_source(name: str) -> Source:
    """Return the source with this name.

    Raises:
        DexFlexError: If there is none.
    """
    for source in SOURCES:
        if name == source:
            return source
    raise DexFlexError(f"`source` must be one of {', '.join(SOURCES)}. Got {name!r}.")
