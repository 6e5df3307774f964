"""Where records come from, tick by tick: a receiver, a stored stream, or one's own device."""

from typing import NamedTuple, Protocol

from lerobot_dexflex.streams.record import Record

STALE_AFTER = 0.1
"""A record that is older is no command any more [s]."""


class Newest(NamedTuple):
    """What a source knows at one time."""

    record: Record | None
    """The newest; None before the first."""
    stale: bool
    """Whether it is older than `STALE_AFTER`, or there is none: then nobody leads the hand."""


class Source(Protocol):
    """Yields the newest record of one hand."""

    def newest(self, now: float) -> Newest:
        """Return the newest record at `now` [s] of the caller's clock, which must not go back."""
        ...
