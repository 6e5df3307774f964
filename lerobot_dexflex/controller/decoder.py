"""The decoder: a bounded correction of the joint targets that inverse kinematics gives for a chunk."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.chunks import residual_block
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.encoder import State

HAND_DOFS = 16


class Decoder(nn.Module):
    """Residual joint targets from state, chosen chunk and its predicted outcome; zero before training."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        width = config.decoder_width
        self.bound = config.residual_bound
        self.inputs = nn.Linear(config.feature_width + config.chunk_width + config.latent_width, width)
        self.first, self.second = nn.Linear(width, width), nn.Linear(width, width)
        self.out = nn.Linear(width, HAND_DOFS)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, state: State, chunk: Tensor, latent: Tensor) -> Tensor:
        """Return residual joint targets within the bound [rad]. Shape (batch, 16).

        Args:
            state: The encoded states.
            chunk: Normalised. Shape (batch, chunk_width).
            latent: Its predicted outcome; zeros hide it. Shape (batch, latent_width).
        """
        hidden = functional.silu(self.inputs(torch.cat([state.features, chunk, latent], -1)))
        hidden = residual_block(hidden, self.first, self.second)
        return self.bound * torch.tanh(self.out(functional.silu(hidden)))
