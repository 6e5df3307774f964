"""The splitter's stage: from motion to which the squeeze of the operator's forces is added."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.history import History
from lerobot_dexflex.controller.splitter import Splitter
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.training.augmentation import AugmentationConfig, augment
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import FitConfig, Stage
from lerobot_dexflex.training.metrics import choose, draw


@dataclass
class SplitterConfig:
    """Losses and data of the stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=8_000))
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    draft_share: float = 0.5
    """Share of rows with the spoilt draft, not the operator's plan."""
    pressing_share: float = 0.6
    """Share of rows whose source presses."""
    least: float = 0.3
    """Smallest squeeze, in units of what the operator's forces need."""
    most: float = 3.0
    """Largest squeeze."""
    unevenness: float = 0.25
    """Standard deviation of what each finger squeezes more or less, relative."""
    strayed_share: float = 0.5
    """Share of rows whose fingers are to be elsewhere by an offset that stays, as a recording asks for it."""
    stray: float = 0.006
    """Standard deviation of such an offset for a finger that carries no load, per axis [m]."""
    stray_loaded: float = 0.0015
    """The same for a finger that carries load; what is more looks like squeeze [m]."""
    held_out_rows: int = 4096
    """Rows of the tuning split in the metrics."""


class Batch(NamedTuple):
    """States, drafts, and what of them is squeeze."""

    history: History
    draft: Tensor  # (batch, 8, fingers, 3) [m]
    squeeze: Tensor  # (batch, fingers, 3) [m]


class SplitterStage(Stage):
    """Train `controller.splitter` on the frozen encoder's states."""

    name = "splitter"

    def __init__(
        self, controller: DexFlexController, train: CorpusData, tune: CorpusData, config: SplitterConfig
    ) -> None:
        self._controller, self._train, self._tune, self._config = controller, train, tune, config
        self._rows = train.rows()
        self._held_out = choose(tune.rows(), config.held_out_rows)
        super().__init__(controller.splitter)

    def batch(self) -> Batch:
        """Draw states with drafts, some of which press."""
        batch = self._gather(self._train, draw(self._rows, self._config.fit.batch_size))
        return batch._replace(history=augment(batch.history, self._config.augmentation))

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the robust error of the squeeze."""
        with torch.no_grad():
            state = self._controller.encode(batch.history)
        network = self.network
        assert isinstance(network, Splitter)
        error = (network(state, batch.draft) - batch.squeeze) / network.scale
        return functional.smooth_l1_loss(error, torch.zeros_like(error), beta=0.1), {}

    def evaluate(self) -> dict[str, float]:
        """Return the rms squeeze, the error of what is found of it, and what is invented [mm]."""
        network = self.average
        assert isinstance(network, Splitter)
        batch = self._gather(self._tune, self._held_out)
        pressing = batch.squeeze.flatten(1).any(1)
        metrics = {"squeeze_mm": _rms_mm(batch.squeeze[pressing])}
        for suffix, history in {"": batch.history, "_no_touch": batch.history.without_touch()}.items():
            error = network(self._controller.encode(history), batch.draft) - batch.squeeze
            metrics[f"error_mm{suffix}"] = _rms_mm(error[pressing])
            metrics[f"invented_mm{suffix}"] = _rms_mm(error[~pressing])
        return metrics

    def _gather(self, data: CorpusData, rows: Tensor) -> Batch:
        config, fingers = self._config, data.layout.n_fingers
        spoilt = torch.rand(len(rows), 1, 1, 1) < config.draft_share
        motion = torch.where(spoilt, data.draft(rows), data.plan(rows))
        strayed = torch.rand(len(rows), 1, 1) < config.strayed_share
        loaded = data.columns["loads"][rows, :, None] > CONTACT_FORCE
        stray = torch.where(loaded, config.stray_loaded, config.stray) * torch.randn(len(rows), fingers, 3)
        motion = motion + (strayed * stray)[:, None]
        pressing = torch.rand(len(rows)) < config.pressing_share
        size = config.least + (config.most - config.least) * torch.rand(len(rows), 1, 1)
        size = size * (1 + config.unevenness * torch.randn(len(rows), fingers, 1))
        squeeze = pressing[:, None, None] * size * data.columns["squeeze"][rows]
        return Batch(data.history(rows), motion + squeeze[:, None], squeeze)


def _rms_mm(values: Tensor) -> float:
    return 1000 * float(values.square().sum(-1).mean().sqrt())
