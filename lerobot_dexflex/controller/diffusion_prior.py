"""DexGen, the baseline: diffusion over chunks, guided toward the draft, and inverse dynamics.

After DexterityGen (Yin et al., RSS 2025). The prior's network, input and data are those of our flow prior.
What DexGen lacks is candidates, a consequence model, a choice, and forces: the draft enters by guidance only,
and the grip is what its inverse dynamics, from proprioception, have learnt of the operator's joint targets.
"""

import math
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor, nn

from lerobot_dexflex.controller.checkpoint import load_weights, save_weights
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.decoder import DROPOUT
from lerobot_dexflex.controller.encoder import State
from lerobot_dexflex.controller.prior import Context, Prior
from lerobot_dexflex.errors import DexFlexError

WEIGHTS = "dexgen.safetensors"
"""Its file in a controller's folder."""
STEPS = 50
"""Noise levels in training."""
LEAD_SCALE = 0.1
"""Unit of the inverse dynamics' joint leads [rad]."""
_OFFSET = 0.008
_CLIP = 6.0


class DiffusionPrior(nn.Module):
    """A diffusion model of normalised chunks that predicts the clean chunk at every noise level.

    Args:
        config: The controller's; the network has the size of its flow prior.
    """

    signal: Tensor

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        self.width = config.finger_chunk_width
        self.network = Prior(config)
        joints = config.layout.n_joints
        inputs, width = config.body_width + config.slow_width + config.chunk_width, config.decoder_width
        self.dynamics = nn.Sequential(
            nn.Linear(inputs, width), nn.SiLU(), nn.Linear(width, width), nn.SiLU(), nn.Linear(width, joints)
        )
        self.dropout = nn.Dropout(DROPOUT)
        self.register_buffer("signal", _cosine_signal(STEPS), persistent=False)

    def context(self, state: State) -> Context:
        """Prepare a state once for any number of noise levels."""
        return self.network.context(state)

    def lead(self, state: State, chunk: Tensor) -> Tensor:
        """Return joint targets minus measured joints [rad], (batch, joints), that bring a chunk about.

        Args:
            state: The encoded states; of these, what proprioception says.
            chunk: Normalised. Shape (batch, fingers, horizon * 3).
        """
        felt = self.dropout(torch.cat([state.body, state.slow], -1))
        return LEAD_SCALE * self.dynamics(torch.cat([felt, chunk.flatten(1)], -1))

    def denoise(self, x: Tensor, level: Tensor, context: Context) -> Tensor:
        """Predict clean chunks.

        Args:
            x: Noisy normalised chunks. Shape (batch, draws, fingers, horizon * 3).
            level: Noise level, 1 (nearly clean) to `STEPS` (pure noise). Shape (batch, draws).
            context: The prepared states.

        Returns:
            Shape of `x`.
        """
        t = (1 - level / STEPS).unsqueeze(-1).expand(-1, -1, x.shape[2])
        return self.network.aim(x, t, torch.zeros_like(t), context)

    def corrupt(self, x_0: Tensor, level: Tensor, noise: Tensor) -> Tensor:
        """Return clean chunks at a noise level; shapes as for `denoise`."""
        signal = self.signal[level][..., None, None]
        return signal.sqrt() * x_0 + (1 - signal).sqrt() * noise

    def sample(self, noise: Tensor, draft: Tensor, guidance: float, steps: int, context: Context) -> Tensor:
        r"""Denoise by DDIM, each step guided toward the draft.

        Guidance descends .. math:: \alpha (1 - \bar\alpha_k) \sum_t \| \Delta x_t - \Delta x^{in}_t \|^2
        from the predicted clean chunk, as an implicit step: the minimum of this and of the distance to the
        prediction. It equals the gradient step where the guidance is weak and stays stable where it is
        strong: 0 samples the prior, and the larger it is the nearer is the result to the draft.

        Args:
            noise: Standard normal. Shape (batch, draws, fingers, horizon * 3).
            draft: Normalised. Shape (batch, fingers, horizon * 3).
            guidance: Strength alpha, not negative.
            steps: Denoising steps, 1 to `STEPS`.
            context: The prepared states.

        Returns:
            Normalised chunks. Shape of `noise`.
        """
        levels = torch.linspace(STEPS, 0, steps + 1).round().long().tolist()
        x, wanted = noise, draft.unsqueeze(1)
        for level, following in pairwise(levels):
            clean = self.denoise(x, x.new_full(x.shape[:2], level), context)
            signal, next_signal = self.signal[level], self.signal[following]
            pull = guidance * (1 - signal)
            clean = ((clean + pull * wanted) / (1 + pull)).clamp(-_CLIP, _CLIP)
            direction = (x - signal.sqrt() * clean) / (1 - signal).sqrt()
            x = next_signal.sqrt() * clean + (1 - next_signal).sqrt() * direction
        return x

    def loss(self, x_0: Tensor, state: State, draws: int = 4) -> Tensor:
        """Return the mean squared error of predicted clean chunks at random noise levels.

        Args:
            x_0: Normalised chunks. Shape (batch, fingers, horizon * 3).
            state: The encoded states before them.
            draws: Pairs of level and noise per chunk.
        """
        target = x_0.unsqueeze(1).expand(-1, draws, -1, -1)
        level = torch.randint(1, STEPS + 1, target.shape[:2], device=x_0.device)
        noisy = self.corrupt(target, level, torch.randn_like(target))
        return (self.denoise(noisy, level.to(x_0), self.context(state)) - target).square().mean()

    def save(self, folder: Path) -> None:
        """Write the weights into a controller's folder."""
        save_weights(self, folder / WEIGHTS)

    @classmethod
    def load(cls, folder: Path, config: ControllerConfig) -> "DiffusionPrior":
        """Load the weights from a controller's folder, frozen and in evaluation mode.

        Raises:
            DexFlexError: If there are none or they do not fit.
        """
        if not (folder / WEIGHTS).is_file():
            raise DexFlexError(f"{folder} has no {WEIGHTS}: train the stage 'dexgen' of this controller.")
        prior = cls(config)
        load_weights(prior, folder / WEIGHTS)
        return prior.eval().requires_grad_(False)


def _cosine_signal(steps: int) -> Tensor:
    """Return the share of signal power per noise level, 1 at level 0 to nearly 0. Shape (steps + 1,)."""
    phase = (torch.arange(steps + 1, dtype=torch.float64) / steps + _OFFSET) / (1 + _OFFSET)
    power = torch.cos(phase * math.pi / 2).square()
    return (power / power[0]).clamp(min=1e-4).float()
