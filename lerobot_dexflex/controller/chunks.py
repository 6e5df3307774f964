"""Chunks of fingertip motion as the networks see them."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.conventions import DRAFT_HORIZON

BRANCHES = ("draft", "pure", "seeded", "finger")
"""Where candidates come from: the draft itself; noise alone; noise around the draft; the draft or noise
around it, of which one finger is drawn anew."""
DRAFT, PURE, SEEDED, FINGER = range(len(BRANCHES))
_CLIP = 6.0


class Candidates(NamedTuple):
    """Chunks to choose from."""

    chunks: Tensor
    """Where the fingertips should be, minus where they are measured [m].
    Shape (batch, candidates, horizon, fingers, 3)."""
    branch: Tensor
    """Index into `BRANCHES`. Shape (candidates,)."""


class ChunkScale(nn.Module):
    """One isotropic scale per step and finger [m], so that directions stay what they are.

    Args:
        fingers: Number of fingers.
    """

    scale: Tensor

    def __init__(self, fingers: int) -> None:
        super().__init__()
        steps = torch.arange(1, DRAFT_HORIZON + 1)[:, None]
        self.register_buffer("scale", 0.001 * steps.expand(-1, fingers).contiguous().float())

    def fit(self, chunks: Tensor) -> None:
        """Take the root mean square of chunks [m], shape (rows, horizon, fingers, 3), as the scale."""
        rms = chunks.double().square().mean((0, 3)).sqrt()
        self.scale.copy_(rms.clamp(min=1e-5))

    def normalize(self, chunks: Tensor) -> Tensor:
        """Return chunks (..., horizon, fingers, 3) [m] as (..., fingers, horizon * 3) of unit size."""
        unit = (chunks / self.scale[..., None]).clamp(-_CLIP, _CLIP)
        return unit.transpose(-2, -3).flatten(-2)

    def normalize_past(self, first_steps: Tensor) -> Tensor:
        """Return first steps of earlier drafts [m] as (batch, drafts * fingers * 3) alike.

        Args:
            first_steps: Shape (batch, drafts, fingers, 3).
        """
        return (first_steps / self.scale[0, :, None]).clamp(-_CLIP, _CLIP).flatten(1)

    def restore(self, values: Tensor) -> Tensor:
        """Return (..., fingers, horizon * 3) as chunks (..., horizon, fingers, 3) [m]."""
        return values.unflatten(-1, (-1, 3)).transpose(-2, -3) * self.scale[..., None]


def distance_to(chunks: Tensor, draft: Tensor, steps: int = 2) -> Tensor:
    """Return the rms fingertip difference over the first steps [mm].

    Args:
        chunks: Shape (batch, candidates, horizon, fingers, 3) [m].
        draft: Shape (batch, horizon, fingers, 3) [m].
        steps: How many steps count.

    Returns:
        Shape (batch, candidates).
    """
    difference = chunks[:, :, :steps] - draft[:, None, :steps]
    return 1000 * difference.square().sum(-1).mean((-1, -2)).sqrt()


def residual_block(x: Tensor, first: nn.Linear, second: nn.Linear) -> Tensor:
    """Return x + second(silu(first(layer norm of x)))."""
    return x + second(functional.silu(first(functional.layer_norm(x, x.shape[-1:]))))
