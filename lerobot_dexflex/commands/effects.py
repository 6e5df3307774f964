"""What an error does to commands, once it is drawn: pure functions, batched, on the commands' device.

`motion` holds displacements of the four commanded fingertips [m], shape (batch, steps, 4, 3).
"""

import torch
from torch import Tensor


def scaled(motion: Tensor, factor: Tensor) -> Tensor:
    """Return every displacement times a factor that broadcasts to (batch, steps, 4, 3)."""
    return factor * motion


def shaken(motion: Tensor, offsets: Tensor) -> Tensor:
    """Return displacements with errors [m] that broadcast to (batch, steps, 4, 3): noise, bias, a push."""
    return motion + offsets


def late(motion: Tensor, lag: Tensor) -> Tensor:
    """Return what was commanded `lag` steps before, (batch, 1) int, or the first command."""
    source = (torch.arange(motion.shape[1], device=motion.device) - lag).clamp(min=0)  # (batch, steps)
    return motion[torch.arange(len(motion), device=motion.device)[:, None], source]


def stopped(motion: Tensor, where: Tensor) -> Tensor:
    """Return displacements of which those in `where` stand still; broadcasts to (batch, steps, 4, 1)."""
    return torch.where(where, 0.0, motion)


def leaving(motion: Tensor, where: Tensor, outward: Tensor) -> Tensor:
    """Return displacements of which those in `where` are `outward` instead.

    Args:
        motion: Displacements.
        where: Fingers that leave the object. Broadcasts to (batch, steps, 4, 1).
        outward: Their displacement per step [m]. Broadcasts to (batch, steps, 4, 3).
    """
    return torch.where(where, outward, motion)
