"""The denoiser: a diffusion transformer over the steps of a chunk, looking at the observation."""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.hands import Hand
from lerobot_policy_dexflex.encoders import IMAGE_TOKENS, Observation, ObservationEncoder

LAST_TIME = 0.9
"""Latest flow time that is trained; later ones are never visited by up to ten Euler steps."""
_TIME_FEATURES = 64
_MODULATIONS = 7
_STEPS_PER_TOKEN = 2
"""Two control steps share a token: half the cost, and a token is still wider than what it carries."""


class Context(NamedTuple):
    """An encoded observation, shared by all blocks, noise draws and integration steps."""

    keys: Tensor
    """Shape (batch, heads, tokens, head_dim)."""
    values: Tensor
    """Shape (batch, heads, tokens, head_dim)."""
    summary: Tensor
    """Shape (batch, dim)."""
    images: Tensor
    """Tokens of the images, one after the other. Shape (batch, image tokens * dim)."""


class Block(nn.Module):
    """Self-attention over the chunk, cross-attention to the observation, MLP (adaLN-zero).

    One layer makes the modulation of all blocks and each block adds a learned offset (PixArt's
    adaLN-single), which saves most of the parameters.
    """

    def __init__(self, dim: int, n_heads: int, mlp_ratio: int, dropout: float) -> None:
        super().__init__()
        self.n_heads = n_heads
        self.dropout = nn.Dropout(dropout)
        self.offset = nn.Parameter(torch.zeros(_MODULATIONS, dim))
        self.qkv = nn.Linear(dim, 3 * dim)
        self.out = nn.Linear(dim, dim)
        self.query = nn.Linear(dim, dim)
        self.cross_out = nn.Linear(dim, dim)
        self.mlp = nn.Sequential(
            nn.Linear(dim, mlp_ratio * dim), nn.GELU("tanh"), nn.Linear(mlp_ratio * dim, dim)
        )

    def forward(self, x: Tensor, modulation: Tensor, context: Context) -> Tensor:
        """Transform x (draws, batch, tokens, dim); modulation has shape (draws, batch, 1, 7, dim)."""
        shift1, scale1, gate1, gate2, shift3, scale3, gate3 = (modulation + self.offset).unbind(-2)
        x = x + gate1 * self.dropout(self._attend_chunk(_modulate(x, shift1, scale1)))
        x = x + gate2 * self.dropout(self._attend_context(functional.layer_norm(x, x.shape[-1:]), context))
        return x + gate3 * self.dropout(self.mlp(_modulate(x, shift3, scale3)))

    def _attend_chunk(self, x: Tensor) -> Tensor:
        draws, batch, tokens, dim = x.shape
        q, k, v = self.qkv(x).view(draws * batch, tokens, 3, self.n_heads, -1).permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(q, k, v)  # (draws * batch, heads, tokens, head_dim)
        return self.out(mixed.transpose(1, 2).reshape(draws, batch, tokens, dim))

    def _attend_context(self, x: Tensor, context: Context) -> Tensor:
        draws, batch, tokens, dim = x.shape
        q = self.query(x).view(draws, batch, tokens, self.n_heads, -1).permute(1, 3, 0, 2, 4)
        # All draws of a row query the same keys: (batch, heads, draws * tokens, head_dim)
        mixed = functional.scaled_dot_product_attention(q.flatten(2, 3), context.keys, context.values)
        mixed = mixed.view(batch, self.n_heads, draws, tokens, -1).permute(2, 0, 3, 1, 4)
        return self.cross_out(mixed.reshape(draws, batch, tokens, dim))


class FlowNetwork(nn.Module):
    """Clean chunk given a noisy one, its flow time and the observation.

    Args:
        hand: The hand.
        image_shapes: Per camera key, (channels, height, width).
        state_dim: Number of measured joints.
        action_dim: Numbers per control step.
        n_arm: Joints of the arm.
        chunk_size: Control steps per chunk.
        dim: Width of tokens.
        n_layers: Transformer blocks.
        n_heads: Attention heads.
        mlp_ratio: Hidden width of the MLPs in units of `dim`.
        n_keypoints: Keypoints per camera.
        dropout: Share of every block's outputs that is hidden in training.
    """

    def __init__(
        self,
        hand: Hand,
        image_shapes: dict[str, tuple[int, ...]],
        state_dim: int,
        action_dim: int,
        n_arm: int,
        chunk_size: int,
        dim: int,
        n_layers: int,
        n_heads: int,
        mlp_ratio: int,
        n_keypoints: int,
        dropout: float = 0.0,
    ) -> None:
        super().__init__()
        self.n_heads = n_heads
        self.observation = ObservationEncoder(hand, image_shapes, state_dim, n_keypoints, dim)
        self.norm = nn.LayerNorm(dim)
        self.key_value = nn.Linear(dim, 2 * dim)
        self.time = nn.Linear(_TIME_FEATURES, dim)
        modulation = nn.Linear(dim, _MODULATIONS * dim)
        self.modulation = nn.Sequential(nn.SiLU(), modulation)
        self.action_in = nn.Linear(_STEPS_PER_TOKEN * action_dim, dim)
        self.position = nn.Parameter(torch.randn(chunk_size // _STEPS_PER_TOKEN, dim) * 0.02)
        self.blocks = nn.ModuleList(Block(dim, n_heads, mlp_ratio, dropout) for _ in range(n_layers))
        self.action_out = nn.Linear(dim, _STEPS_PER_TOKEN * action_dim)
        n_seen = IMAGE_TOKENS * len(image_shapes)
        self.arm_seen = nn.Sequential(nn.Linear(n_seen * dim, dim), nn.GELU(), nn.Linear(dim, n_arm))
        """Where images alone see the arm go; it only teaches the image encoders to look."""
        for layer in (modulation, self.action_out):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def encode(self, observation: Observation) -> Context:
        """Encode an observation once for any number of noisy chunks."""
        tokens = self.norm(self.observation(observation))
        key_value = self.key_value(tokens).unflatten(-1, (2, self.n_heads, -1))
        keys, values = key_value.permute(2, 0, 3, 1, 4)
        images = tokens[:, : IMAGE_TOKENS * len(self.observation.cameras)].flatten(1)
        return Context(keys, values, tokens.mean(1), images)

    def clean(self, x_t: Tensor, t: Tensor, context: Context) -> Tensor:
        """Return the clean chunk that is expected at flow time t, which is 0 at noise and 1 at data.

        The velocity (clean - x_t) / (1 - t) follows from it: the network then never has to carry the noise
        through its narrow tokens, and the last integration step lands on a clean chunk.

        Args:
            x_t: Chunks on their way. Shape (draws, batch, chunk_size, action_dim).
            t: At most `LAST_TIME`. Shape (draws, batch).
            context: The encoded observation of each batch row.

        Returns:
            Shape of `x_t`.
        """
        condition = self.time(_time_features(t)) + context.summary  # (draws, batch, dim)
        modulation = self.modulation(condition).unflatten(-1, (_MODULATIONS, -1)).unsqueeze(2)
        x = self.action_in(x_t.unflatten(2, (-1, _STEPS_PER_TOKEN)).flatten(3)) + self.position
        for block in self.blocks:
            x = block(x, modulation, context)
        return self.action_out(functional.layer_norm(x, x.shape[-1:])).view_as(x_t)


def _modulate(x: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    return functional.layer_norm(x, x.shape[-1:]) * (1 + scale) + shift


def _time_features(t: Tensor) -> Tensor:
    frequencies = torch.exp(torch.linspace(0, math.log(1000), _TIME_FEATURES // 2, device=t.device))
    phase = t.unsqueeze(-1) * frequencies
    return torch.cat([phase.sin(), phase.cos()], -1)
