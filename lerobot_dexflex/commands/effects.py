"""What an error does to drafts, once it is drawn: pure functions, batched, on the drafts' device.

`motion` holds where the fingertips should be over the next steps, relative to where they are [m], shape
(batch, steps, fingers, 3).
"""

import torch
from torch import Tensor


def scaled(motion: Tensor, factor: Tensor) -> Tensor:
    """Return every motion times a factor that broadcasts to (batch, steps, fingers, 3)."""
    return factor * motion


def shaken(motion: Tensor, offsets: Tensor) -> Tensor:
    """Return motions with errors [m] that broadcast to (batch, steps, fingers, 3): noise, bias, a push."""
    return motion + offsets


def replaced(motion: Tensor, where: Tensor, other: Tensor) -> Tensor:
    """Return motions of which those in `where` are others: stopped, or leaving the object.

    Args:
        motion: Motions.
        where: Fingers. Broadcasts to (batch, steps, fingers, 1).
        other: Their motions instead [m]. Broadcasts to (batch, steps, fingers, 3).
    """
    return torch.where(where, other, motion)
