"""What the configurations of both policies have in common."""

from collections.abc import Sequence

from draccus.utils import ParsingError
from lerobot.configs import NormalizationMode

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces import Method


def check_draft(name: str, valid: Sequence[str]) -> None:
    """Refuse a name that is none of the valid ones; the empty one leaves the choice to the policy.

    Raises:
        ParsingError: draccus hides the message of any ValueError from a configuration, but not this one.
    """
    if name not in valid:
        empty = ", or empty" if "" in valid else ""
        raise ParsingError(f"`draft` must be {' or '.join(filter(None, valid))}{empty}. Got {name!r}.")


def check_hand(name: str) -> None:
    """Refuse a name that is no hand.

    Raises:
        ParsingError: draccus hides the message of any ValueError from a configuration, but not this one.
    """
    try:
        get_hand(name)
    except DexFlexError as error:
        raise ParsingError(f"--policy.hand: {error}") from error


def check_interface(name: str) -> None:
    """Refuse a name that is no interface.

    Raises:
        ParsingError: draccus hides the message of any ValueError from a configuration, but not this one.
    """
    try:
        Method.parse(name)
    except DexFlexError as error:
        raise ParsingError(f"--policy.interface: {error}") from error


def no_normalization() -> dict[str, NormalizationMode]:
    """Return the mapping that lets raw units through: interfaces need them, and policies normalise inside."""
    return dict.fromkeys(("VISUAL", "STATE", "ACTION"), NormalizationMode.IDENTITY)
