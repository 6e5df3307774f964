"""Second stage: the world model, from what happened when commands were executed."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.encoder import State
from lerobot_dexflex.controller.history import History
from lerobot_dexflex.controller.world_model import Prediction, WorldModel
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.training.augmentation import AugmentationConfig, augment
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import FitConfig, Stage
from lerobot_dexflex.training.metrics import choose, draw, roc_auc

_HELD = 2
_LAST_STEPS = 2
SLIP = 0.005
"""A fingertip slips if it moves so far in the object's frame in a horizon [m]: farther than it rolls."""


@dataclass
class WorldModelConfig:
    """Losses and data of the second stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=10_000))
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    event_weight: float = 0.2
    """Weight of the losses on loss of contact, slip and loss of the grasp."""
    held_out_rows: int = 2048
    """Rows of the tuning split in the metrics."""


class Events(NamedTuple):
    """What came of a chunk."""

    loaded: Tensor  # fingers in contact now (batch, fingers) bool
    contact_loss: Tensor  # of these, unloaded at the end (batch, fingers) bool
    slip: Tensor  # of these, moved along the object (batch, fingers) bool
    grasp_loss: Tensor  # (batch,) bool

    @property
    def held(self) -> Tensor:
        """Whether there is a grasp to lose. Shape (batch,)."""
        return self.loaded.sum(1) >= _HELD


class Batch(NamedTuple):
    """Chunks and what they led to."""

    now: History
    chunk: Tensor  # (batch, 8, fingers, 3) [m]
    later: History
    events: Events


class WorldModelStage(Stage):
    """Train `controller.world_model` on the frozen encoder's latents."""

    name = "world_model"

    def __init__(
        self, controller: DexFlexController, train: CorpusData, tune: CorpusData, config: WorldModelConfig
    ) -> None:
        self._controller, self._config = controller, config
        self._train, self._tune = train, tune
        self._rows = train.transition_rows()
        self._held_out = choose(tune.transition_rows(), config.held_out_rows)
        super().__init__(controller.world_model)

    def batch(self) -> Batch:
        """Draw transitions."""
        batch = recorded(self._train, draw(self._rows, self._config.fit.batch_size))
        return batch._replace(now=augment(batch.now, self._config.augmentation))

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the error of the latent and of the events."""
        network, events = self.network, batch.events
        assert isinstance(network, WorldModel)
        with torch.no_grad():
            state, later = self._encode(batch)
        prediction = network(state, self._controller.scale.normalize(batch.chunk).unsqueeze(1))
        parts = {"latent": functional.mse_loss(prediction.latent[:, 0], later)}
        for name, (logit, truth) in _answers(prediction, events).items():
            parts[name] = torch.nan_to_num(functional.binary_cross_entropy_with_logits(logit, truth.float()))
        loss = parts["latent"] + self._config.event_weight * sum(
            value for name, value in parts.items() if name != "latent"
        )
        return loss, {name: value.detach() for name, value in parts.items()}

    def evaluate(self) -> dict[str, float]:
        """Return latent errors, against the state staying as it is, and the events' AUC and frequency."""
        batch = recorded(self._tune, self._held_out)
        state, later = self._encode(batch)
        error = (self._predict(state, batch).latent[:, 0] - later).square().mean()
        metrics = {"error": float(error)}
        metrics["vs_copy"] = float(error / (state.latent - later).square().mean())
        for suffix, now in {"": batch.now, "_no_touch": batch.now.without_touch()}.items():
            prediction = self._predict(self._controller.encode(now), batch)
            for name, (logit, truth) in _answers(prediction, batch.events).items():
                metrics[f"{name}_auc{suffix}"] = roc_auc(logit, truth)
                metrics[f"{name}_share"] = float(truth.float().mean())
        return metrics

    def _predict(self, state: State, batch: Batch) -> Prediction:
        network = self.average
        assert isinstance(network, WorldModel)
        return network(state, self._controller.scale.normalize(batch.chunk).unsqueeze(1))

    def _encode(self, batch: Batch) -> tuple[State, Tensor]:
        """Return the states now and the latents later, in one call of the encoder."""
        both = self._controller.encode(
            History(*[torch.cat(p) for p in zip(batch.now, batch.later, strict=True)])
        )
        rows = len(batch.chunk)
        return State(*[part[:rows] for part in both]), both.latent[rows:]


def recorded(corpus: CorpusData, rows: Tensor) -> Batch:
    """Return transitions that happened; rows as in `CorpusData.transition_rows`."""
    later = rows + DRAFT_HORIZON
    return Batch(corpus.history(rows), corpus.executed(rows), corpus.history(later), events(corpus, rows))


def events(corpus: CorpusData, rows: Tensor) -> Events:
    """Return what happened within a horizon of some rows."""
    columns = corpus.columns
    loads = columns["loads"]
    loaded = loads[rows] > CONTACT_FORCE
    ending = torch.stack([loads[rows + DRAFT_HORIZON - k] for k in range(_LAST_STEPS)], 1)
    kept = ending.amin(1) > CONTACT_FORCE
    moved = columns["in_object"][rows + DRAFT_HORIZON] - columns["in_object"][rows]
    slip = loaded & kept & (moved.norm(dim=-1) > SLIP)
    lost = columns["lost"][rows[:, None] + torch.arange(DRAFT_HORIZON)].any(1)
    return Events(loaded, loaded & ~kept, slip, lost)


def _answers(prediction: Prediction, events: Events) -> dict[str, tuple[Tensor, Tensor]]:
    """Return logits and truth of each event where the question makes sense."""
    loaded, held = events.loaded, events.held
    return {
        "contact_loss": (prediction.contact_loss[:, 0][loaded], events.contact_loss[loaded]),
        "slip": (prediction.slip[:, 0][loaded], events.slip[loaded]),
        "grasp_loss": (prediction.grasp_loss[:, 0][held], events.grasp_loss[held]),
    }
