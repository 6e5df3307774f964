"""The splitter: what of a draft commands into the object, so that the rest is motion."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.chunks import residual_block
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.decoder import DROPOUT
from lerobot_dexflex.controller.encoder import State

_FARTHEST = 6.0
"""Bound of a draft, in units of its scale."""


class Splitter(nn.Module):
    """Tell squeeze from motion: a position servo presses by commanding places inside the object."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        width, fingers = config.splitter_width, config.n_fingers
        self.scale = config.squeeze_scale
        self.dropout = nn.Dropout(DROPOUT)
        self.inputs = nn.Linear(config.feature_width + config.chunk_width, width)
        self.first, self.second = nn.Linear(width, width), nn.Linear(width, width)
        self.out = nn.Linear(width, 3 * fingers)
        for parameter in self.out.parameters():  # Untrained, it takes every draft for motion.
            nn.init.zeros_(parameter)

    def forward(self, state: State, draft: Tensor) -> Tensor:
        """Return what of every step of a draft commands into the object [m]. Shape (batch, fingers, 3).

        Args:
            state: The encoded states.
            draft: Shape (batch, horizon, fingers, 3) [m].
        """
        unit = (draft / self.scale).clamp(-_FARTHEST, _FARTHEST).flatten(1)
        known = torch.cat([self.dropout(state.features), unit], -1)
        hidden = residual_block(functional.silu(self.inputs(known)), self.first, self.second)
        return self.scale * self.out(functional.silu(hidden)).unflatten(-1, (-1, 3))
