"""What the configurations of both policies have in common."""

from draccus.utils import ParsingError
from lerobot.configs import NormalizationMode

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces import Method


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
