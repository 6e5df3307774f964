"""Vary normalised training observations; each function leaves its input untouched."""

import torch
from torch import Tensor
from torch.nn import functional


def shift_images(images: Tensor, pixels: int) -> Tensor:
    """Shift each image by up to `pixels` in both directions, repeating its border.

    Args:
        images: Shape (batch, channels, height, width).
        pixels: Largest shift; 0 returns the images themselves.
    """
    if pixels == 0:
        return images
    batch, _, height, width = images.shape
    padded = functional.pad(images, [pixels] * 4, mode="replicate")
    windows = padded.unfold(2, height, 1).unfold(3, width, 1)
    rows, columns = torch.randint(2 * pixels + 1, (2, batch), device=images.device)
    return windows[torch.arange(batch, device=images.device), :, rows, columns]


def vary_light(images: Tensor, strength: float) -> Tensor:
    """Scale contrast by 1 + strength * n and shift brightness by strength * n, n standard normal per image.

    Args:
        images: In [-1, 1]. Shape (batch, channels, height, width).
        strength: Standard deviation of both; 0 returns the images themselves.
    """
    if strength == 0:
        return images
    contrast, brightness = strength * torch.randn(2, len(images), 1, 1, 1, device=images.device)
    return images * (1 + contrast) + brightness


def jitter(values: Tensor, std: Tensor | float) -> Tensor:
    """Add normal noise of a standard deviation that broadcasts to `values`."""
    return values + std * torch.randn_like(values)
