"""The baseline's stage: DexGen's diffusion prior and inverse dynamics on the frozen encoder."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from lerobot_dexflex.controller.chunks import distance_to
from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.diffusion_prior import LEAD_SCALE, DiffusionPrior
from lerobot_dexflex.controller.encoder import State
from lerobot_dexflex.controller.history import History
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.augmentation import AugmentationConfig, augment
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import FitConfig, Stage
from lerobot_dexflex.training.metrics import choose, draw

_DRAWS = 32
_STEPS = 8
_GUIDANCES = (1.0, 3.0, 10.0, 30.0, 100.0)
_NOISE = 0.002


@dataclass
class DexGenConfig:
    """Data of the baseline's stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=16_000, lr=1.5e-3))
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    draws: int = 4
    """Pairs of noise level and noise per row."""
    held_out_rows: int = 256
    """Rows of the tuning split in the metrics."""


class Batch(NamedTuple):
    """States, the operator's plans and the joint commands that were executed there."""

    history: History
    chunk: Tensor  # (batch, 8, fingers, 3) [m]
    lead: Tensor  # joint targets minus joints (batch, joints) [rad]
    own: Tensor  # whether the operator's own command was executed (batch,) bool


class DexGenStage(Stage):
    """Train a `DiffusionPrior` for a controller whose encoder is trained."""

    name = "dexgen"

    def __init__(
        self,
        controller: DexFlexController,
        prior: DiffusionPrior,
        train: CorpusData,
        tune: CorpusData,
        config: DexGenConfig,
    ) -> None:
        self._controller, self._train, self._tune, self._config = controller, train, tune, config
        self._rows = train.rows()
        self._held_out = choose(tune.rows(), config.held_out_rows)
        if not len(self._rows):
            raise DexFlexError("The training split has no rows whose object is still held.")
        super().__init__(prior)

    def batch(self) -> Batch:
        """Draw states with the operator's plan."""
        batch = _gather(self._train, draw(self._rows, self._config.fit.batch_size))
        return batch._replace(history=augment(batch.history, self._config.augmentation))

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the error of denoised chunks and, where the operator's were executed, of joint commands."""
        prior = self.network
        assert isinstance(prior, DiffusionPrior)
        with torch.no_grad():
            state = self._controller.encode(batch.history)
        chunk = self._controller.scale.normalize(batch.chunk)
        denoised = prior.loss(chunk, state, self._config.draws)
        error = ((prior.lead(state, chunk) - batch.lead) / LEAD_SCALE)[batch.own]
        lead = torch.nan_to_num(functional.smooth_l1_loss(error, torch.zeros_like(error), beta=0.3))
        return denoised + lead, {"denoised": denoised.detach(), "lead": lead.detach()}

    def evaluate(self) -> dict[str, float]:
        """Return errors of the best of N free draws and of one draw guided by a noisy draft, in mm."""
        history, chunk, lead, own = _gather(self._tune, self._held_out)
        state = self._controller.encode(history)
        noise = _NOISE * (2 * torch.rand(chunk[:, 0].shape, generator=torch.Generator().manual_seed(1)) - 1)
        draft = chunk + noise[:, None]
        free = self._errors(state, draft, chunk, 0.0)
        metrics = {f"best_of_{n}_mm": float(free[:, :n].amin(1).mean()) for n in (1, 8, _DRAWS)}
        metrics["noisy_draft_mm"] = float(distance_to(draft.unsqueeze(1), chunk).mean())
        prior = self.average
        assert isinstance(prior, DiffusionPrior)
        found = prior.lead(state, self._controller.scale.normalize(chunk))[own]
        metrics["lead_mrad"] = 1000 * float((found - lead[own]).square().mean().sqrt())
        metrics["lead_rest_mrad"] = 1000 * float(lead[own].square().mean().sqrt())
        for guidance in _GUIDANCES:
            error = self._errors(state, draft, chunk, guidance)
            metrics[f"guided_{guidance:g}_mm"] = float(error[:, 0].mean())
        return metrics

    def _errors(self, state: State, draft: Tensor, chunk: Tensor, guidance: float) -> Tensor:
        """Return the error of every draw [mm]. Shape (rows, draws)."""
        prior, scale = self.average, self._controller.scale
        assert isinstance(prior, DiffusionPrior)
        shape = (len(chunk), _DRAWS if guidance == 0 else 1, chunk.shape[2], prior.width)
        noise = torch.randn(shape, generator=torch.Generator().manual_seed(0))
        drawn = prior.sample(noise, scale.normalize(draft), guidance, _STEPS, prior.context(state))
        return distance_to(scale.restore(drawn), chunk)


def _gather(data: CorpusData, rows: Tensor) -> Batch:
    columns = data.columns
    lead = columns["joint_targets"][rows] - columns["joints"][rows]
    return Batch(data.history(rows), data.plan(rows), lead, columns["expert"][rows])
