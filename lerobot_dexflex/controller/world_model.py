"""The world model: what a chunk would lead to."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.chunks import residual_block
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.encoder import State


class Prediction(NamedTuple):
    """What the world model says of candidates."""

    latent: Tensor
    """Predicted z a horizon later. Shape (batch, candidates, latent_width)."""
    contact_loss: Tensor
    """Logit that a finger loaded now is unloaded at the end. Shape (batch, candidates, 4)."""
    grasp_loss: Tensor
    """Logit that the grasp is lost within the horizon. Shape (batch, candidates)."""


class WorldModel(nn.Module):
    """Predict the change of z; what depends on the state alone is computed once for all candidates."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        width = config.world_width
        self.latent_width = config.latent_width
        self.from_state = nn.Linear(config.feature_width, width)
        self.from_chunk = nn.Linear(config.chunk_width, width, bias=False)
        self.first, self.second = nn.Linear(width, width), nn.Linear(width, width)
        self.out = nn.Linear(width, config.latent_width + len(config.fingers) + 1)

    def forward(self, state: State, chunks: Tensor) -> Prediction:
        """Predict the outcome of normalised chunks, shape (batch, candidates, chunk_width)."""
        hidden = functional.silu(self.from_state(state.features).unsqueeze(1) + self.from_chunk(chunks))
        out = self.out(functional.silu(residual_block(hidden, self.first, self.second)))
        change, contact_loss, grasp_loss = torch.split(
            out, [self.latent_width, out.shape[-1] - self.latent_width - 1, 1], -1
        )
        return Prediction(state.latent.unsqueeze(1) + change, contact_loss, grasp_loss.squeeze(-1))
