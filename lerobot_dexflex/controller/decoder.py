"""The decoder: which fingers should press, and with what force."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.chunks import residual_block
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.encoder import State

_LIKELY = 0.5
_OUTPUTS = 4
"""Of each finger: its force, and whether it is to press."""
DROPOUT = 0.2
"""Share of what it knows of a state that training hides from the decoder and its like: else they learn
episodes by heart."""


class Forces(NamedTuple):
    """What the decoder says of each finger, in its distal link's frame."""

    vector: Tensor
    """Force on the object if the finger is to press [N]. Shape (batch, fingers, 3)."""
    pressing: Tensor
    """Logit that it is to press. Shape (batch, fingers)."""

    def grip(self) -> Tensor:
        """Return the forces of fingers that likely are to press, else zero. Shape (batch, fingers, 3)."""
        return self.vector * (self.pressing.sigmoid() > _LIKELY)[..., None]


class Decoder(nn.Module):
    """Contact forces from the state and the motion that is to be executed."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        width, fingers = config.decoder_width, config.n_fingers
        self.scale, self.largest = config.force_scale, config.largest_force
        self.dropout = nn.Dropout(DROPOUT)
        self.inputs = nn.Linear(config.feature_width + config.chunk_width, width)
        self.first, self.second = nn.Linear(width, width), nn.Linear(width, width)
        self.third, self.fourth = nn.Linear(width, width), nn.Linear(width, width)
        self.out = nn.Linear(width, fingers * _OUTPUTS)

    def forward(self, state: State, chunk: Tensor) -> Forces:
        """Return the forces of every finger.

        Args:
            state: The encoded states.
            chunk: Normalised motion. Shape (batch, fingers, horizon * 3).
        """
        features = self.dropout(state.features)
        hidden = functional.silu(self.inputs(torch.cat([features, chunk.flatten(1)], -1)))
        hidden = residual_block(hidden, self.first, self.second)
        hidden = residual_block(hidden, self.third, self.fourth)
        out = self.out(self.dropout(functional.silu(hidden))).unflatten(-1, (-1, _OUTPUTS))
        vector = self.scale * out[..., :3]
        size = vector.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        return Forces(vector * (self.largest / size).clamp(max=1.0), out[..., 3])
