"""Second stage: the world model, from recorded transitions and replayed chunks."""

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
from lerobot_dexflex.training.corpus_data import CorpusData, ReplayData
from lerobot_dexflex.training.fit import FitConfig, Stage
from lerobot_dexflex.training.metrics import choose, draw, roc_auc

_KINDS = ("search", "operator", "acquisition", "loop", "failed")
_SOURCES = ("replay_expert", "replay_prior", "replay_perturbed", "replay_seeded")
_HELD = 2
_LAST_STEPS = 2


@dataclass
class WorldModelConfig:
    """Losses and data of the second stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=10_000))
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    replay_share: float = 0.5
    """Share of rows that are replays, where there are any."""
    event_weight: float = 0.2
    """Weight of the losses on contact loss and grasp loss."""
    held_out_rows: int = 512
    """Rows of each kind and source of the tuning split in the metrics."""


class Batch(NamedTuple):
    """Chunks and what they led to."""

    now: History
    chunk: Tensor  # (batch, 8, 4, 3) [m]
    later: History
    loaded: Tensor  # fingers in contact now (batch, 4) bool
    contact_loss: Tensor  # of these, unloaded at the end (batch, 4) bool
    grasp_loss: Tensor  # (batch,) bool

    @property
    def held(self) -> Tensor:
        """Whether there is a grasp to lose. Shape (batch,)."""
        return self.loaded.sum(1) >= _HELD


class WorldModelStage(Stage):
    """Train `controller.world_model` on the frozen encoder's latents."""

    name = "world_model"

    def __init__(
        self,
        controller: DexFlexController,
        train: tuple[CorpusData, ReplayData],
        tune: tuple[CorpusData, ReplayData],
        config: WorldModelConfig,
    ) -> None:
        self._controller, self._config = controller, config
        (self._corpus, self._replays), self._tune = train, tune
        self._rows = self._corpus.transition_rows()
        super().__init__(controller.world_model)

    def batch(self) -> Batch:
        """Draw recorded transitions and replays."""
        size = self._config.fit.batch_size
        n_replays = round(self._config.replay_share * size) if len(self._replays) else 0
        parts = [recorded(self._corpus, draw(self._rows, size - n_replays))] if n_replays < size else []
        if n_replays:
            parts.append(
                replayed(self._corpus, self._replays, torch.randint(len(self._replays), (n_replays,)))
            )
        batch = _join(parts)
        return batch._replace(now=augment(batch.now, self._config.augmentation))

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the error of the latent and of the two events."""
        network = self.network
        assert isinstance(network, WorldModel)
        with torch.no_grad():
            state, later = self._encode(batch)
        chunk = self._controller.scale.normalize(batch.chunk).unsqueeze(1)
        prediction = network(state, chunk)
        latent = functional.mse_loss(prediction.latent[:, 0], later)
        entropy = functional.binary_cross_entropy_with_logits
        contact = entropy(
            prediction.contact_loss[:, 0][batch.loaded], batch.contact_loss[batch.loaded].float()
        )
        grasp = entropy(prediction.grasp_loss[:, 0][batch.held], batch.grasp_loss[batch.held].float())
        events = torch.nan_to_num(contact) + torch.nan_to_num(grasp)
        loss = latent + self._config.event_weight * events
        parts = {"latent": latent, "contact_loss": contact, "grasp_loss": grasp}
        return loss, {name: value.detach() for name, value in parts.items()}

    def evaluate(self) -> dict[str, float]:
        """Return latent errors per source, against the state staying as it is, and the events' AUC."""
        corpus, replays = self._tune
        metrics, batches = {}, []
        rows, count = corpus.transition_rows(), self._config.held_out_rows
        kinds = corpus.columns["kind"][rows]
        for kind, name in enumerate(_KINDS):
            if len(chosen := choose(rows[kinds == kind], count)):
                batches.append((name, recorded(corpus, chosen)))
        for source, name in enumerate(_SOURCES if len(replays) else ()):
            index = (replays.columns["source"] == source).nonzero().flatten()
            if len(chosen := choose(index, count)):
                batches.append((name, replayed(corpus, replays, chosen)))
        for name, batch in batches:
            state, later = self._encode(batch)
            error = (self._predict(state, batch).latent[:, 0] - later).square().mean()
            metrics[f"{name}_error"] = float(error)
            metrics[f"{name}_vs_copy"] = float(error / (state.latent - later).square().mean())
        every = _join([batch for _, batch in batches])
        for name, now in {"": every.now, "_no_touch": every.now.without_touch()}.items():
            prediction = self._predict(self._controller.encode(now), every)
            loaded, held = every.loaded, every.held
            metrics[f"contact_loss_auc{name}"] = roc_auc(
                prediction.contact_loss[:, 0][loaded], every.contact_loss[loaded]
            )
            metrics[f"grasp_loss_auc{name}"] = roc_auc(
                prediction.grasp_loss[:, 0][held], every.grasp_loss[held]
            )
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
    loads = corpus.columns["loads"]
    ending = torch.stack([loads[rows + DRAFT_HORIZON - k] for k in range(_LAST_STEPS)], 1)
    return _batch(
        now=corpus.history(rows),
        chunk=corpus.ahead("executed", rows),
        later=corpus.history(rows + DRAFT_HORIZON),
        loads=loads[rows],
        ending=ending,
        lost=corpus.ahead("lost", rows).any(1),
    )


def replayed(corpus: CorpusData, replays: ReplayData, index: Tensor) -> Batch:
    """Return transitions that were replayed."""
    replay = replays.batch(index)
    loads, ending = corpus.columns["loads"][replay.rows], replay.loads[:, -_LAST_STEPS:]
    return _batch(replay.now, replay.chunk, replay.later, loads, ending, replay.lost)


def _batch(now: History, chunk: Tensor, later: History, loads: Tensor, ending: Tensor, lost: Tensor) -> Batch:
    loaded = loads > CONTACT_FORCE
    return Batch(now, chunk, later, loaded, loaded & (ending.amin(1) <= CONTACT_FORCE), lost)


def _join(parts: list[Batch]) -> Batch:
    def histories(name: str) -> History:
        fields = zip(*[getattr(part, name) for part in parts], strict=True)
        return History(*[torch.cat(values) for values in fields])

    others = {
        name: torch.cat([getattr(p, name) for p in parts]) for name in Batch._fields[1:] if name != "later"
    }
    return Batch(now=histories("now"), later=histories("later"), **others)
