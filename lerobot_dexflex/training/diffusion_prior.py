"""The baseline's stage: DexGen's diffusion prior on the frozen encoder, from the chunks of our own prior."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.controller.chunks import distance_to
from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.controller.encoder import State
from lerobot_dexflex.controller.history import History
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.augmentation import AugmentationConfig, augment
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import FitConfig, Stage
from lerobot_dexflex.training.metrics import choose, draw
from lerobot_dexflex.training.proxy_drafts import constant_velocity

_DRAWS = 32
_STEPS = 8
_GUIDANCES = (1.0, 3.0, 10.0, 30.0, 100.0)
_NOISE = 0.002


@dataclass
class DexGenConfig:
    """Data of the baseline's stage; shares are those of the first stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=16_000, lr=1.5e-3))
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    label_share: float = 0.35
    """Share of rows that are no expert's own step, whose chunk is the operator's labels."""
    draws: int = 4
    """Pairs of noise level and noise per row."""
    held_out_rows: int = 256
    """Rows of the tuning split in the metrics."""


class Batch(NamedTuple):
    """States and chunks that the prior shall propose there."""

    history: History
    chunk: Tensor  # (batch, 8, 4, 3) [m]


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
        self._rows = [train.chunk_rows(expert=True), train.chunk_rows(expert=False)]
        self._held_out = choose(tune.chunk_rows(expert=True), config.held_out_rows)
        if not len(self._rows[0]):
            raise DexFlexError("The training split has no expert chunks: 8 steps in a row with `expert` set.")
        super().__init__(prior)

    def batch(self) -> Batch:
        """Draw expert chunks and, by `label_share`, labelled ones."""
        size = self._config.fit.batch_size
        n_labels = round(self._config.label_share * size) if len(self._rows[1]) else 0
        counts = (size - n_labels, n_labels)
        rows = torch.cat([draw(r, n) for r, n in zip(self._rows, counts, strict=True) if n])
        history = augment(self._train.history(rows), self._config.augmentation)
        return Batch(history, self._train.clean_chunk(rows))

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the error of denoised chunks."""
        prior = self.network
        assert isinstance(prior, DiffusionPrior)
        with torch.no_grad():
            state = self._controller.encode(batch.history)
        return prior.loss(self._controller.scale.normalize(batch.chunk), state, self._config.draws), {}

    def evaluate(self) -> dict[str, float]:
        """Return errors of the best of N free draws and of one draw guided by a noisy draft, in mm."""
        chunk = self._tune.clean_chunk(self._held_out)
        state = self._controller.encode(self._tune.history(self._held_out))
        noise = _NOISE * (2 * torch.rand(chunk[:, 0].shape, generator=torch.Generator().manual_seed(1)) - 1)
        draft = constant_velocity(chunk[:, 0] + noise)
        free = self._errors(state, draft, chunk, 0.0)
        metrics = {f"best_of_{n}_mm": float(free[:, :n].amin(1).mean()) for n in (1, 8, _DRAWS)}
        metrics["noisy_draft_mm"] = float(distance_to(draft.unsqueeze(1), chunk).mean())
        for guidance in _GUIDANCES:
            error = self._errors(state, draft, chunk, guidance)
            metrics[f"guided_{guidance:g}_mm"] = float(error[:, 0].mean())
        return metrics

    def _errors(self, state: State, draft: Tensor, chunk: Tensor, guidance: float) -> Tensor:
        """Return the error of every draw [mm]. Shape (rows, draws)."""
        prior, scale = self.average, self._controller.scale
        assert isinstance(prior, DiffusionPrior)
        shape = (len(chunk), _DRAWS if guidance == 0 else 1, prior.width)
        noise = torch.randn(shape, generator=torch.Generator().manual_seed(0))
        drawn = prior.sample(noise, scale.normalize(draft), guidance, _STEPS, prior.context(state))
        return distance_to(scale.restore(drawn), chunk)
