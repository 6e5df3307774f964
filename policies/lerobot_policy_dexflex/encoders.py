"""Turn one observation into a few tokens: images, touch and joints."""

import math
from typing import NamedTuple

import torch
from lerobot.policies.diffusion.modeling_diffusion import SpatialSoftmax
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.hands import Hand

IMAGE_TOKENS = 2
"""Tokens per camera; they come first."""


class Observation(NamedTuple):
    """What the network sees, normalised to unit scale."""

    images: dict[str, Tensor]
    """Per camera, in [-1, 1]. Shape (batch, 3, height, width)."""
    state: Tensor
    """Measured joints. Shape (batch, joints)."""
    fingertips: Tensor
    """Measured fingertips, one scale per finger. Shape (batch, fingers, 3)."""
    gravity: Tensor
    """Unit vector in the palm frame. Shape (batch, 3)."""
    touch: Tensor
    """Compressed taxel forces. Shape (batch, fingers, taxels of a finger)."""
    touch_missing: Tensor
    """Rows whose touch is hidden. Shape (batch,), bool."""


class ImageEncoder(nn.Module):
    """Locate keypoints at a quarter of the resolution, with context from an eighth (a small feature pyramid).

    Keypoints are the expected position under a softmax, so they resolve well below a cell of the map.

    Args:
        height: Image height [pixel], a multiple of 8.
        width: Image width [pixel], a multiple of 8.
        n_keypoints: Keypoints per image.
        dim: Width of the tokens.
    """

    def __init__(self, height: int, width: int, n_keypoints: int, dim: int) -> None:
        super().__init__()
        self.fine = nn.Sequential(_conv(3, 16, 5, 2), _conv(16, 32, 3, 2))
        self.coarse = nn.Sequential(_conv(32, 64, 3, 2), _conv(64, 64, 3, 1))
        self.lateral = nn.Conv2d(64, 32, 1)
        self.keypoints = SpatialSoftmax((32, height // 4, width // 4), num_kp=n_keypoints)
        assert self.keypoints.nets is not None
        # Spread the softmax from the start; with near-uniform weights every keypoint is the image centre.
        nn.init.normal_(self.keypoints.nets.weight, std=0.5)
        self.keypoint_token = _mlp(2 * n_keypoints, dim)
        self.layout = nn.Sequential(nn.Conv2d(64, 12, 1), nn.AdaptiveAvgPool2d(4), nn.Flatten(1))
        self.layout_token = _mlp(12 * 16, dim)

    def forward(self, image: Tensor) -> Tensor:
        """Return tokens (batch, 2, dim) of images (batch, 3, height, width) in [-1, 1]."""
        fine = self.fine(image)
        coarse = self.coarse(fine)
        pyramid = fine + functional.interpolate(self.lateral(coarse), scale_factor=2, mode="nearest")
        points = self.keypoints(pyramid).flatten(1)
        return torch.stack([self.keypoint_token(points), self.layout_token(self.layout(coarse))], 1)


class TouchEncoder(nn.Module):
    """One token per finger from its taxels, their total force and where the finger is.

    Args:
        hand: The hand that feels.
        dim: Width of the tokens.
    """

    def __init__(self, hand: Hand, dim: int) -> None:
        super().__init__()
        self.finger = _mlp(math.prod(hand.taxels) + 1 + 3, dim)
        self.identity = nn.Parameter(torch.randn(hand.n_fingers, dim) * 0.02)
        self.missing = nn.Parameter(torch.zeros(hand.n_fingers, dim))

    def forward(self, touch: Tensor, fingertips: Tensor, missing: Tensor) -> Tensor:
        """Return tokens (batch, fingers, dim); see `Observation` for the arguments."""
        # Taxels are compressed by a square root, so the sum of squares is the finger's total force.
        total = touch.square().sum(-1, keepdim=True).sqrt()
        tokens = self.finger(torch.cat([touch, total, fingertips], -1))
        return torch.where(missing[:, None, None], self.missing, tokens) + self.identity


class ObservationEncoder(nn.Module):
    """All tokens of an observation.

    Args:
        hand: The hand.
        image_shapes: Per camera key, (channels, height, width).
        state_dim: Number of measured joints.
        n_keypoints: Keypoints per camera.
        dim: Width of the tokens.
    """

    def __init__(
        self,
        hand: Hand,
        image_shapes: dict[str, tuple[int, ...]],
        state_dim: int,
        n_keypoints: int,
        dim: int,
    ) -> None:
        super().__init__()
        self.cameras = sorted(image_shapes)
        sizes = [image_shapes[key][1:] for key in self.cameras]
        self.image = nn.ModuleList(ImageEncoder(height, width, n_keypoints, dim) for height, width in sizes)
        self.touch = TouchEncoder(hand, dim)
        self.body = _mlp(state_dim + 3 * hand.n_fingers + 3, dim)
        self.n_tokens = IMAGE_TOKENS * len(self.cameras) + hand.n_fingers + 1
        self.position = nn.Parameter(torch.randn(self.n_tokens, dim) * 0.02)

    def forward(self, observation: Observation) -> Tensor:
        """Return tokens (batch, n_tokens, dim)."""
        body = torch.cat([observation.state, observation.fingertips.flatten(1), observation.gravity], -1)
        tokens = [
            encoder(observation.images[key]) for encoder, key in zip(self.image, self.cameras, strict=True)
        ]
        tokens.append(self.touch(observation.touch, observation.fingertips, observation.touch_missing))
        tokens.append(self.body(body).unsqueeze(1))
        return torch.cat(tokens, 1) + self.position


def _conv(channels_in: int, channels_out: int, kernel: int, stride: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels_in, channels_out, kernel, stride, kernel // 2, bias=False),
        nn.GroupNorm(channels_out // 8, channels_out),
        nn.ReLU(inplace=True),
    )


def _mlp(dim_in: int, dim: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(dim_in, dim), nn.SiLU(), nn.Linear(dim, dim))
