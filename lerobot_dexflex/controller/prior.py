"""The prior: a few-step flow over chunks, given the state alone.

Every finger is a token with a flow time of its own. So one finger can be drawn anew while the others stay
what a draft says: what would an operator do with this finger here, if it did that with the others?
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.encoder import State

LAST_TIME = 0.95
"""Beyond this flow time the velocity is not sharpened further: its denominator stays bounded."""
_FREQUENCIES = 16
_MODULATIONS = 7


class Context(NamedTuple):
    """An encoded state, shared by all candidates, blocks and integration steps."""

    keys: Tensor
    """Shape (batch, heads, tokens, head_dim)."""
    values: Tensor
    """Shape (batch, heads, tokens, head_dim)."""
    summary: Tensor
    """Shape (batch, 1, 1, width)."""


class Block(nn.Module):
    """Self-attention over the chunk, cross-attention to the state, MLP (adaLN-zero, shared modulation)."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.offset = nn.Parameter(torch.zeros(_MODULATIONS, width))
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.query = nn.Linear(width, width)
        self.cross_out = nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 2 * width), nn.SiLU(), nn.Linear(2 * width, width))

    def forward(self, x: Tensor, modulation: Tensor, context: Context) -> Tensor:
        """Transform x (batch, draws, fingers, width); modulation is (batch, draws, fingers, 7, width)."""
        shift1, scale1, gate1, gate2, shift3, scale3, gate3 = (modulation + self.offset).unbind(-2)
        x = x + gate1 * self._attend_chunk(_modulate(x, shift1, scale1))
        x = x + gate2 * self._attend_state(functional.layer_norm(x, x.shape[-1:]), context)
        return x + gate3 * self.mlp(_modulate(x, shift3, scale3))

    def _attend_chunk(self, x: Tensor) -> Tensor:
        rows = x.flatten(0, 1)  # (batch * draws, fingers, width)
        q, k, v = self.qkv(rows).unflatten(-1, (3, self.heads, -1)).permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(q, k, v)
        return self.out(mixed.transpose(1, 2).reshape(x.shape))

    def _attend_state(self, x: Tensor, context: Context) -> Tensor:
        q = self.query(x.flatten(1, 2)).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        mixed = functional.scaled_dot_product_attention(q, context.keys, context.values)
        return self.cross_out(mixed.transpose(1, 2).reshape(x.shape))


class Prior(nn.Module):
    """A flow from noise (time 0) to normalised chunks (time 1) with steps of any size, finger by finger.

    The network names the chunk at which a straight step of the given size aims; the velocity follows from
    it as (aim - x) / (1 - t). A step of size 0 is ordinary flow matching; larger steps are trained to equal
    two of half the size, from any start time, so that drafts can be joined at any level.
    """

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        width, fingers = config.prior_width, config.n_fingers
        self.heads = config.prior_heads
        self.project = nn.ModuleList(
            nn.Linear(n, width)
            for n in (config.body_width, config.contact_width, config.finger_width, config.slow_width)
        )
        self.finger_place = nn.Parameter(torch.randn(fingers, width) * 0.1)
        self.key_value = nn.Linear(width, 2 * width)
        self.time = nn.Linear(4 * _FREQUENCIES, width)
        modulation = nn.Linear(width, _MODULATIONS * width)
        self.modulation = nn.Sequential(nn.SiLU(), modulation)
        self.chunk_in = nn.Linear(config.finger_chunk_width, width)
        self.place = nn.Parameter(torch.randn(fingers, width) * 0.1)
        self.blocks = nn.ModuleList(Block(width, config.prior_heads) for _ in range(config.prior_layers))
        self.chunk_out = nn.Linear(width, config.finger_chunk_width)
        for layer in (modulation, self.chunk_out):
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)

    def context(self, state: State) -> Context:
        """Prepare a state once for any number of velocities."""
        to_body, to_contact, to_finger, to_slow = self.project
        fingers = to_finger(state.fingers) + self.finger_place
        single = [to_body(state.body), to_contact(state.contact), to_slow(state.slow)]
        tokens = torch.cat([torch.stack(single, 1), fingers], 1)
        tokens = functional.layer_norm(tokens, tokens.shape[-1:])
        keys, values = self.key_value(tokens).unflatten(-1, (2, self.heads, -1)).permute(2, 0, 3, 1, 4)
        return Context(keys, values, tokens.mean(1, keepdim=True)[:, :, None])

    def aim(self, x: Tensor, t: Tensor, step: Tensor, context: Context) -> Tensor:
        """Return the chunk at which a step of this size points.

        Args:
            x: Normalised chunks on their way. Shape (batch, draws, fingers, horizon * 3).
            t: Flow time of every finger. Shape (batch, draws, fingers).
            step: Size of the step in flow time. Shape (batch, draws, fingers).
            context: The prepared states.

        Returns:
            Shape of `x`.
        """
        return self._aim(x, self._modulation_at(t, step, context.summary), context)

    def velocity(self, x: Tensor, t: Tensor, step: Tensor, context: Context) -> Tensor:
        """Return the mean dx/dt over a step that begins at (x, t); arguments as for `aim`."""
        return (self.aim(x, t, step, context) - x) / (1 - t).clamp(min=1 - LAST_TIME)[..., None]

    def sample(self, x: Tensor, start: Tensor, steps: int, context: Context) -> Tensor:
        """Integrate every finger of every draw from its start time to 1, in as many batched calls as steps.

        Args:
            x: Where the draws begin: noise, noisy drafts, or drafts.
                Shape (batch, draws, fingers, horizon * 3).
            start: Start time of each finger; at 1 it stays what it is. Shape (draws, fingers).
            steps: Number of steps.
            context: The prepared states.

        Returns:
            Clean normalised chunks. Shape of `x`.
        """
        levels, which = start.unique(return_inverse=True)  # Few: what depends on time is computed once each.
        t, size = levels, (1 - levels) / steps
        for _ in range(steps):
            modulation = self._modulation_at(t, size, context.summary.squeeze(1))
            modulation = modulation.index_select(1, which.flatten()).unflatten(1, which.shape)
            share = torch.where(size > 0, size / (1 - t).clamp(min=1e-4), 0.0).clamp(max=1)
            x = x + share[which][..., None] * (self._aim(x, modulation, context) - x)
            t = t + size
        return x

    def _modulation_at(self, t: Tensor, step: Tensor, summary: Tensor) -> Tensor:
        """Return what times (...,) and summaries (batch, ..., width) do to blocks: (batch, ..., 7, width)."""
        condition = self.time(torch.cat([_waves(t), _waves(step)], -1)) + summary
        return self.modulation(condition).unflatten(-1, (_MODULATIONS, -1))

    def _aim(self, x: Tensor, modulation: Tensor, context: Context) -> Tensor:
        tokens = self.chunk_in(x) + self.place
        for block in self.blocks:
            tokens = block(tokens, modulation, context)
        return self.chunk_out(functional.layer_norm(tokens, tokens.shape[-1:]))


def _modulate(x: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    return functional.layer_norm(x, x.shape[-1:]) * (1 + scale) + shift


def _waves(t: Tensor) -> Tensor:
    frequencies = torch.exp(torch.linspace(0, math.log(60), _FREQUENCIES, device=t.device))
    phase = t.unsqueeze(-1) * frequencies
    return torch.cat([phase.sin(), phase.cos()], -1)
