"""Drafts of an imagined imperfect operator, made from clean motion."""

import torch
from torch import Tensor

from lerobot_dexflex.commands import effects
from lerobot_dexflex.conventions import DRAFT_HORIZON

_LARGEST_DELAY = 3


def constant_velocity(displacement: Tensor) -> Tensor:
    """Return the chunk that repeats a displacement (batch, 4, 3), as a glove gives it: (batch, 8, 4, 3)."""
    return displacement.unsqueeze(1).expand(-1, DRAFT_HORIZON, -1, -1).contiguous()


def proxy_drafts(past: Tensor, clean: Tensor) -> tuple[Tensor, Tensor]:
    """Spoil clean motion in one of seven ways per row, the past and the chunk alike.

    Rows stay clean, get noise, a gain, a delay, single fingers lost or pushed aside, a bias, or smoothing;
    two thirds of the drafts are then held at constant velocity. Drawn from torch's global generator.

    Args:
        past: Clean displacements of the 8 steps before, oldest first [m]. Shape (batch, 8, 4, 3).
        clean: Clean chunk [m]. Shape (batch, 8, 4, 3).

    Returns:
        The drafts (batch, 8, 4, 3) and their history (batch, 8, 4, 3) [m].
    """
    motion = torch.cat([past, clean], 1)
    rows = len(motion)
    way = torch.randint(7, (rows,))
    ways = (_same, _noise, _gain, _delay, _fingers, _bias, _smooth)
    for number, corrupt in enumerate(ways):
        chosen = way == number
        motion[chosen] = corrupt(motion[chosen])
    history, draft = motion.split([past.shape[1], DRAFT_HORIZON], 1)
    held = torch.rand(rows) < 2 / 3
    return torch.where(held[:, None, None, None], constant_velocity(draft[:, 0]), draft), history


def _same(motion: Tensor) -> Tensor:
    return motion


def _noise(motion: Tensor) -> Tensor:
    size = 0.002 * torch.rand(len(motion), 1, 1, 1)
    return effects.shaken(motion, size * (2 * torch.rand_like(motion) - 1))


def _gain(motion: Tensor) -> Tensor:
    return effects.scaled(motion, 0.4 + 1.4 * torch.rand(len(motion), 1, 1, 1))


def _delay(motion: Tensor) -> Tensor:
    return effects.late(motion, torch.randint(1, _LARGEST_DELAY + 1, (len(motion), 1)))


def _fingers(motion: Tensor) -> Tensor:
    """Stop a finger, or push it somewhere for the last few steps on."""
    rows, steps = motion.shape[:2]
    finger = torch.nn.functional.one_hot(torch.randint(4, (rows,)), 4).view(rows, 1, 4, 1)
    push = torch.nn.functional.normalize(torch.randn(rows, 1, 1, 3), dim=-1) * (
        0.001 + 0.002 * torch.rand(rows, 1, 1, 1)
    )
    begin = torch.randint(steps - DRAFT_HORIZON + 1, (rows, 1))
    during = (torch.arange(steps) >= begin).view(rows, steps, 1, 1) * finger
    stopped, pushed = effects.stopped(motion, during > 0), effects.shaken(motion, during * push)
    return torch.where(torch.rand(rows, 1, 1, 1) < 0.5, stopped, pushed)


def _bias(motion: Tensor) -> Tensor:
    return effects.shaken(motion, 0.0005 * torch.randn(len(motion), 1, 4, 3))


def _smooth(motion: Tensor) -> Tensor:
    weight = 0.2 + 0.6 * torch.rand(len(motion), 1, 1)
    smooth = [motion[:, 0]]
    for k in range(1, motion.shape[1]):
        smooth.append(smooth[-1] + weight * (motion[:, k] - smooth[-1]))
    return torch.stack(smooth, 1)
