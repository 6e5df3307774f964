"""First stage: encoder and prior together, from chunks of the expert and of the operator's labels."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.chunks import distance_to
from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.encoder import Encoder, State
from lerobot_dexflex.controller.history import History
from lerobot_dexflex.controller.prior import LAST_TIME, Prior
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.training.augmentation import AugmentationConfig, augment
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import FitConfig, Stage
from lerobot_dexflex.training.metrics import choose, draw, roc_auc

_DRAWS = 32


@dataclass
class EncoderPriorConfig:
    """Losses and data of the first stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=16_000, lr=1.5e-3))
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    label_share: float = 0.35
    """Share of rows that are no expert's own step, whose chunk is the operator's labels (recoveries)."""
    consistency_share: float = 0.25
    """Share of rows that train large steps to equal two smaller ones of the moving average."""
    readout_weight: float = 0.1
    """Weight of the losses on loads now and contact later."""
    held_out_rows: int = 256
    """Rows of the tuning split in the metrics."""


class Batch(NamedTuple):
    """States, chunks that the prior shall propose there, and what the hand carries."""

    history: History
    chunk: Tensor  # (batch, 8, 4, 3) [m]
    loads: Tensor  # (batch, 4) [N]
    loads_later: Tensor  # (batch, 4) [N]
    continues: Tensor  # whether loads_later is known (batch,) bool


class EncoderPriorStage(Stage):
    """Train `controller.encoder` and `controller.prior`."""

    name = "encoder_prior"

    def __init__(
        self, controller: DexFlexController, train: CorpusData, tune: CorpusData, config: EncoderPriorConfig
    ) -> None:
        self._train, self._tune, self._config = train, tune, config
        self._scale = controller.scale
        self._rows = [train.chunk_rows(expert=True), train.chunk_rows(expert=False)]
        self._held_out = choose(tune.chunk_rows(expert=True), config.held_out_rows)
        self._held_out_labels = choose(tune.chunk_rows(expert=False), config.held_out_rows)
        self._continuing = [data.continuing(DRAFT_HORIZON) for data in (train, tune)]
        if not len(self._rows[0]):
            raise DexFlexError("The training split has no expert chunks: 8 steps in a row with `expert` set.")
        self._scale.fit(train.clean_chunk(choose(self._rows[0], 20_000)))
        super().__init__(part(controller))

    def batch(self) -> Batch:
        """Draw expert chunks and, by `label_share`, labelled ones."""
        size = self._config.fit.batch_size
        n_labels = round(self._config.label_share * size) if len(self._rows[1]) else 0
        rows = torch.cat(
            [draw(r, n) for r, n in zip(self._rows, (size - n_labels, n_labels), strict=True) if n]
        )
        rows = rows[torch.randperm(size)]
        batch = _gather(self._train, rows, self._continuing[0])
        return batch._replace(history=augment(batch.history, self._config.augmentation))

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return flow matching and self-consistency, and the readouts of loads and contact."""
        encoder, prior = _parts(self.network)
        state = encoder(batch.history)
        chunk = self._scale.normalize(batch.chunk).unsqueeze(1)
        n_flow = len(chunk) - round(self._config.consistency_share * len(chunk))
        average_encoder, average_prior = _parts(self.average)
        with torch.no_grad():
            average_state = average_encoder(History(*[values[n_flow:] for values in batch.history]))
        flow, consistency = flow_losses(prior, average_prior, state, average_state, chunk)
        log_loads, later = encoder.readout(state)
        load = functional.mse_loss(log_loads, batch.loads.log1p())
        known = batch.continues
        contact = functional.binary_cross_entropy_with_logits(
            later[known], (batch.loads_later[known] > CONTACT_FORCE).float()
        )
        loss = flow + consistency + self._config.readout_weight * (load + contact)
        parts = {"flow": flow, "consistency": consistency, "load": load, "contact": contact}
        return loss, {name: value.detach() for name, value in parts.items()}

    def evaluate(self) -> dict[str, float]:
        """Return errors of the best of N draws [mm], the readouts' quality and the use of slow codes."""
        encoder, prior = _parts(self.average)
        metrics: dict[str, float] = {}
        batch = _gather(self._tune, self._held_out, self._continuing[1])
        state = encoder(batch.history)
        for nfe in (1, 2, 4):
            error = self._errors(prior, state, batch.chunk, nfe)
            metrics[f"best_of_1_nfe{nfe}_mm"] = float(error[:, 0].mean())
            metrics[f"best_of_{_DRAWS}_nfe{nfe}_mm"] = float(error.amin(1).mean())
        metrics["best_of_8_nfe4_mm"] = float(error[:, :8].amin(1).mean())
        zero = torch.zeros_like(batch.chunk).unsqueeze(1)
        metrics["standing_still_mm"] = float(distance_to(zero, batch.chunk).mean())
        hidden = encoder(batch.history.without_touch())
        error = self._errors(prior, hidden, batch.chunk, 4)
        metrics["best_of_8_no_touch_mm"] = float(error[:, :8].amin(1).mean())
        if len(self._held_out_labels):
            labelled = _gather(self._tune, self._held_out_labels, self._continuing[1])
            error = self._errors(prior, encoder(labelled.history), labelled.chunk, 4)
            metrics["labels_best_of_8_mm"] = float(error[:, :8].amin(1).mean())
        return metrics | self._readout_metrics(encoder)

    def _errors(self, prior: Prior, state: State, chunk: Tensor, nfe: int) -> Tensor:
        noise = torch.randn(len(chunk), _DRAWS, chunk[0].numel(), generator=torch.Generator().manual_seed(0))
        drawn = prior.sample(noise, [0.0] * _DRAWS, [nfe] * _DRAWS, prior.context(state))
        return distance_to(self._scale.restore(drawn), chunk)

    def _readout_metrics(self, encoder: Encoder) -> dict[str, float]:
        rows = choose(self._continuing[1].nonzero().flatten(), 8 * self._config.held_out_rows, seed=1)
        batch = _gather(self._tune, rows, self._continuing[1])
        metrics = {}
        truth = (batch.loads_later > CONTACT_FORCE).flatten()
        for name, history in {"": batch.history, "_no_touch": batch.history.without_touch()}.items():
            log_loads, later = encoder.readout(encoder(history))
            metrics[f"contact_later_auc{name}"] = roc_auc(later.flatten(), truth)
            metrics[f"log_load_error{name}"] = float((log_loads - batch.loads.log1p()).abs().mean())
        codes = torch.bincount(encoder.slow(batch.history)[1].long()).double()
        share = codes[codes > 0] / codes.sum()
        metrics["slow_perplexity"] = float((-(share * share.log()).sum()).exp())
        return metrics


def part(controller: DexFlexController) -> nn.Module:
    """Return what of a controller this stage decides."""
    names = ("encoder", "prior", "scale")
    return nn.ModuleDict({name: controller.get_submodule(name) for name in names})


def flow_losses(
    prior: Prior, average: Prior, state: State, average_state: State, chunk: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the flow-matching and the self-consistency loss of a batch, which together are a mean.

    Args:
        prior: In training.
        average: Its moving average, the teacher of consistency.
        state: Encoded states.
        average_state: The last of these states, encoded by the average; these rows train consistency.
        chunk: Normalised data. Shape (batch, 1, chunk_width).
    """
    rows, n_consistent = len(chunk), len(average_state.body)
    n_flow = rows - n_consistent
    # Flow times are dense near the noise, Beta(1, 1.5); steps and their starts fill the triangle evenly.
    t = LAST_TIME * (1 - torch.rand(rows, 1).pow(1 / 1.5))
    size = torch.rand(rows, 1)
    t[n_flow:] = torch.rand(n_consistent, 1) * (1 - size[n_flow:])
    size[:n_flow] = 0
    x = (1 - t)[..., None] * torch.randn_like(chunk) + t[..., None] * chunk
    target = (chunk - x) / (1 - t).clamp(min=1 - LAST_TIME)[..., None]
    if n_consistent:
        target[n_flow:] = _two_half_steps(average, average_state, x[n_flow:], t[n_flow:], size[n_flow:] / 2)
    error = (prior.velocity(x, t, size, prior.context(state)) - target).square().mean((1, 2))
    return error[:n_flow].sum() / rows, error[n_flow:].sum() / rows


@torch.no_grad()
def _two_half_steps(prior: Prior, state: State, x: Tensor, t: Tensor, half: Tensor) -> Tensor:
    """Return the mean velocity over two steps of the given size, (batch, 1)."""
    context = prior.context(state)
    first = prior.velocity(x, t, half, context)
    second = prior.velocity(x + half[..., None] * first, t + half, half, context)
    return (first + second) / 2


def _parts(network: nn.Module) -> tuple[Encoder, Prior]:
    encoder, prior = network.get_submodule("encoder"), network.get_submodule("prior")
    assert isinstance(encoder, Encoder)
    assert isinstance(prior, Prior)
    return encoder, prior


def _gather(data: CorpusData, rows: Tensor, continuing: Tensor) -> Batch:
    known = continuing[rows]
    later = torch.where(known, rows + DRAFT_HORIZON, rows)
    loads = data.columns["loads"]
    return Batch(data.history(rows), data.clean_chunk(rows), loads[rows], loads[later], known)
