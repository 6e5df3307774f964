"""Contact events of an episode: a finger, or anything else, touches the object or leaves it."""

import numpy as np
from numpy.typing import NDArray

Flags = NDArray[np.bool_]
AROUND = 5
"""Control steps on each side of an event that are around it: half a second in all."""


def contact_events(contacts: Flags) -> Flags:
    """Return in which control steps a contact began or ended; flickers of a single step do not count.

    Args:
        contacts: Who touches the object, before the first step and after every step. Shape (steps + 1, N).

    Returns:
        Shape (steps,).
    """
    padded = np.concatenate([contacts[:1], contacts, contacts[-1:]])
    before, old, new, after = padded[:-3], padded[1:-2], padded[2:-1], padded[3:]
    return ((old != new) & (before == old) & (new == after)).any(1)


def around(events: Flags, steps: int = AROUND) -> Flags:
    """Return which steps are at most so many from an event. Shape (steps,)."""
    window = np.ones(2 * steps + 1)
    return np.convolve(events, window, "full")[steps : steps + len(events)] > 0
