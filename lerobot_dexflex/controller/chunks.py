"""Chunks of fingertip displacements as the networks see them."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.settings import SelectionSettings
from lerobot_dexflex.conventions import FINGER_NAMES

DRAFT, PURE, SEEDED, CONTACT = 0, 1, 2, 3
"""Branches that candidates come from."""
_CLIP = 6.0
_RECENT = 4


class Candidates(NamedTuple):
    """Chunks to choose from."""

    chunks: Tensor
    """Displacements of the commanded fingertips [m]. Shape (batch, candidates, horizon, 4, 3)."""
    branch: Tensor
    """`DRAFT`, `PURE`, `SEEDED` or `CONTACT`. Shape (candidates,)."""


class ChunkScale(nn.Module):
    """One isotropic scale per finger [m], so that directions stay what they are."""

    scale: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("scale", torch.full((len(FINGER_NAMES),), 0.001))

    def fit(self, chunks: Tensor) -> None:
        """Take the root mean square of displacements [m], shape (..., 4, 3), as the scale."""
        rms = chunks.double().flatten(0, -3).square().mean((0, 2)).sqrt()
        self.scale.copy_(rms.clamp(min=1e-5))

    def normalize(self, chunks: Tensor) -> Tensor:
        """Return chunks (..., steps, 4, 3) [m] as (..., steps * 12) of about unit size, clipped at 6."""
        return (chunks / self.scale[:, None]).clamp(-_CLIP, _CLIP).flatten(-3)

    def restore(self, values: Tensor) -> Tensor:
        """Return (..., steps * 12) as chunks (..., steps, 4, 3) [m]."""
        return values.unflatten(-1, (-1, len(FINGER_NAMES), 3)) * self.scale[:, None]


def seed_chunks(draft: Tensor, drafts_history: Tensor, settings: SelectionSettings) -> Tensor:
    """Return what each draft-seeded candidate starts from.

    Args:
        draft: Shape (batch, horizon, 4, 3) [m].
        drafts_history: First displacements before this step, oldest first [m]. Shape (batch, 8, 4, 3).
        settings: Their number, levels and seeds; candidates cycle over levels first, then over seeds.

    Returns:
        Shape (batch, n_seeded, horizon, 4, 3) [m].
    """
    starts = []
    for name in settings.seeds:
        if name == "draft":
            starts.append(draft)
        elif name == "mean":
            recent = torch.cat([drafts_history[:, 1 - _RECENT :], draft[:, :1]], 1)
            known = (recent != 0).flatten(2).any(-1).sum(1).clamp(min=1)
            mean = recent.sum(1) / known[:, None, None]
            starts.append(mean.unsqueeze(1).expand_as(draft))
        else:
            starts.append(float(name) * draft)
    which = [k // len(settings.levels) % len(starts) for k in range(settings.n_seeded)]
    return torch.stack(starts, 1)[:, which]


def distance_to(chunks: Tensor, draft: Tensor, steps: int = 2) -> Tensor:
    """Return the rms fingertip difference over the first steps [mm].

    Args:
        chunks: Shape (batch, candidates, horizon, 4, 3) [m].
        draft: Shape (batch, horizon, 4, 3) [m].
        steps: How many steps count.

    Returns:
        Shape (batch, candidates).
    """
    difference = chunks[:, :, :steps] - draft[:, None, :steps]
    return 1000 * difference.square().sum(-1).mean((-1, -2)).sqrt()


def residual_block(x: Tensor, first: nn.Linear, second: nn.Linear) -> Tensor:
    """Return x + second(silu(first(layer norm of x)))."""
    return x + second(functional.silu(first(functional.layer_norm(x, x.shape[-1:]))))
