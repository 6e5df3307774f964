"""What a check found."""

from typing import NamedTuple


class Finding(NamedTuple):
    """The outcome of one check of a hand."""

    check: str
    """Name of the check, one word."""
    passed: bool
    found: str
    """The numbers, of the worst finger or joint."""
    valid: str
    """Which numbers would pass."""
    remedy: str
    """Which fields of the hand to look at if it fails."""
