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
    """Logit that a finger loaded now is unloaded at the end. Shape (batch, candidates, fingers)."""
    slip: Tensor
    """Logit that a finger loaded now slips along the object. Shape (batch, candidates, fingers)."""
    grasp_loss: Tensor
    """Logit that the grasp is lost within the horizon. Shape (batch, candidates)."""


class WorldModel(nn.Module):
    """Predict the change of z; what depends on the state alone is computed once for all candidates."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        width, fingers = config.world_width, config.n_fingers
        self.sizes = [config.latent_width, fingers, fingers, 1]
        self.from_state = nn.Linear(config.feature_width, width)
        self.from_chunk = nn.Linear(config.chunk_width, width, bias=False)
        self.first, self.second = nn.Linear(width, width), nn.Linear(width, width)
        self.out = nn.Linear(width, sum(self.sizes))

    def forward(self, state: State, chunks: Tensor) -> Prediction:
        """Predict the outcome of normalised chunks, shape (batch, candidates, fingers, horizon * 3)."""
        chunks = chunks.flatten(-2)
        hidden = functional.silu(self.from_state(state.features).unsqueeze(1) + self.from_chunk(chunks))
        out = self.out(functional.silu(residual_block(hidden, self.first, self.second)))
        change, contact_loss, slip, grasp_loss = torch.split(out, self.sizes, -1)
        latent = state.latent.unsqueeze(1) + change
        return Prediction(latent, contact_loss, slip, grasp_loss.squeeze(-1))
