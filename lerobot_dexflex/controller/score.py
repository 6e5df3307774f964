"""The score: how likely a candidate is what the operator would want here."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.chunks import residual_block
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.encoder import State


class Score(nn.Module):
    """Rank candidates given state, draft and recent drafts; trained as a softmax over candidates."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        width, chunk = config.score_width, config.chunk_width
        history = config.draft_history * config.n_fingers * 3
        self.from_state = nn.Linear(config.feature_width + chunk + history, width)
        self.from_candidate = nn.Linear(2 * chunk + config.latent_width, width, bias=False)
        self.first, self.second = nn.Linear(width, width), nn.Linear(width, width)
        self.out = nn.Linear(width, 1)

    def forward(
        self, state: State, draft: Tensor, drafts_history: Tensor, chunks: Tensor, latent: Tensor
    ) -> Tensor:
        """Return one score per candidate.

        Args:
            state: The encoded states.
            draft: Normalised. Shape (batch, fingers, horizon * 3).
            drafts_history: First steps of earlier drafts, in units of the first step's scale. Shape (batch,
                8 * fingers * 3).
            chunks: Normalised candidates. Shape (batch, candidates, fingers, horizon * 3).
            latent: The world model's predictions, zeros hide them. Shape (batch, candidates, latent_width).

        Returns:
            Shape (batch, candidates).
        """
        draft, chunks = draft.flatten(1), chunks.flatten(2)
        row = self.from_state(torch.cat([state.features, draft, drafts_history], -1)).unsqueeze(1)
        candidate = self.from_candidate(torch.cat([chunks, chunks - draft.unsqueeze(1), latent], -1))
        hidden = residual_block(functional.silu(row + candidate), self.first, self.second)
        return self.out(functional.silu(hidden)).squeeze(-1)
