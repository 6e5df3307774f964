"""First stage: encoder, prior and decoder together, from the operator's plans and forces."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from lerobot_dexflex.controller.chunks import distance_to
from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.decoder import Decoder, Forces
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
_PARTS = ("encoder", "prior", "decoder", "scale")


@dataclass
class EncoderPriorConfig:
    """Losses and data of the first stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=16_000, lr=1.5e-3))
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    draft_share: float = 0.3
    """Share of rows whose decoder sees the spoilt draft as the motion to be executed, not the plan."""
    consistency_share: float = 0.25
    """Share of rows that train large steps to equal two smaller ones of the moving average."""
    own_time_share: float = 0.5
    """Share of rows whose fingers have flow times of their own."""
    clean_share: float = 0.4
    """Of these, share of fingers that are shown as they are, so that the others answer to them."""
    readout_weight: float = 0.1
    """Weight of the losses on loads now, contact later and what the slow token says of the right forces."""
    force_weight: float = 1.0
    """Weight of the decoder's losses."""
    held_out_rows: int = 512
    """Rows of the tuning split in the metrics."""


class Batch(NamedTuple):
    """States, the operator's plans and forces there, and what the hand carries."""

    history: History
    chunk: Tensor  # (batch, 8, fingers, 3) [m]
    executed: Tensor  # motion shown to the decoder (batch, 8, fingers, 3) [m]
    forces: Tensor  # in the distal links' frames (batch, fingers, 3) [N]
    loads: Tensor  # (batch, fingers) [N]
    loads_later: Tensor  # (batch, fingers) [N]
    continues: Tensor  # whether loads_later is known (batch,) bool


class EncoderPriorStage(Stage):
    """Train `controller.encoder`, `controller.prior` and `controller.decoder`."""

    name = "encoder_prior"

    def __init__(
        self, controller: DexFlexController, train: CorpusData, tune: CorpusData, config: EncoderPriorConfig
    ) -> None:
        self._train, self._tune, self._config = train, tune, config
        self._scale = controller.scale
        self._rows = train.rows()
        self._held_out = choose(tune.rows(), config.held_out_rows)
        self._continuing = [data.continuing(DRAFT_HORIZON) for data in (train, tune)]
        if not len(self._rows):
            raise DexFlexError("The training split has no rows whose object is still held.")
        self._scale.fit(train.plan(choose(self._rows, 20_000)))
        super().__init__(part(controller))

    def batch(self) -> Batch:
        """Draw states with the operator's plan."""
        rows = draw(self._rows, self._config.fit.batch_size)
        batch = _gather(self._train, rows, self._continuing[0], self._config.draft_share)
        return batch._replace(history=augment(batch.history, self._config.augmentation))

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return flow matching and self-consistency, the forces' errors, and the readouts' errors."""
        config = self._config
        encoder, prior, decoder = _networks(self.network)
        state = encoder(batch.history)
        chunk = self._scale.normalize(batch.chunk).unsqueeze(1)
        n_flow = len(chunk) - round(config.consistency_share * len(chunk))
        average_encoder, average_prior, _ = _networks(self.average)
        with torch.no_grad():
            average_state = average_encoder(History(*[values[n_flow:] for values in batch.history]))
        t, size = flow_times(chunk.shape[2], len(chunk), n_flow, config.own_time_share, config.clean_share)
        flow, consistency = flow_losses(prior, average_prior, state, average_state, chunk, t, size)
        force, pressing = force_losses(
            decoder(state, self._scale.normalize(batch.executed)), batch.forces, decoder.scale
        )
        log_loads, later, log_forces = encoder.readout(state)
        load = functional.mse_loss(log_loads, batch.loads.log1p())
        slow = functional.mse_loss(log_forces, batch.forces.norm(dim=-1).log1p())
        known = batch.continues
        contact = functional.binary_cross_entropy_with_logits(
            later[known], (batch.loads_later[known] > CONTACT_FORCE).float()
        )
        loss = flow + consistency + config.readout_weight * (load + contact + slow)
        loss = loss + config.force_weight * (force + config.readout_weight * pressing)
        parts = {"flow": flow, "consistency": consistency, "force": force, "pressing": pressing}
        parts |= {"load": load, "contact": contact, "slow": slow}
        return loss, {name: value.detach() for name, value in parts.items()}

    def evaluate(self) -> dict[str, float]:
        """Return errors of draws [mm], of forces with and without touch, and the readouts' quality."""
        encoder, prior, decoder = _networks(self.average)
        metrics: dict[str, float] = {}
        batch = _gather(self._tune, self._held_out, self._continuing[1], 0.0)
        state = encoder(batch.history)
        for nfe in (1, 2, 4):
            error = self._errors(prior, state, batch.chunk, nfe)
            metrics[f"best_of_1_nfe{nfe}_mm"] = float(error[:, 0].mean())
            metrics[f"best_of_{_DRAWS}_nfe{nfe}_mm"] = float(error.amin(1).mean())
        one = self._one_finger(prior, state, batch.chunk)
        metrics["one_finger_mm"], metrics["one_finger_still_mm"] = one
        zero = torch.zeros_like(batch.chunk).unsqueeze(1)
        metrics["standing_still_mm"] = float(distance_to(zero, batch.chunk).mean())
        motion = self._scale.normalize(batch.executed)
        for name, history in {"": batch.history, "_no_touch": batch.history.without_touch()}.items():
            forces = decoder(encoder(history), motion)
            metrics |= {f"{key}{name}": value for key, value in force_metrics(forces, batch.forces).items()}
        return metrics | self._readout_metrics(encoder)

    def _errors(self, prior: Prior, state: State, chunk: Tensor, nfe: int) -> Tensor:
        shape = (len(chunk), _DRAWS, *self._scale.normalize(chunk).shape[1:])
        noise = torch.randn(shape, generator=torch.Generator().manual_seed(0))
        drawn = prior.sample(noise, torch.zeros(shape[1:3]), nfe, prior.context(state))
        return distance_to(self._scale.restore(drawn), chunk)

    def _one_finger(self, prior: Prior, state: State, chunk: Tensor) -> tuple[float, float]:
        """Return the error of a finger drawn anew, the others following the plan, and of its rest [mm]."""
        fingers = chunk.shape[2]
        x = self._scale.normalize(chunk).unsqueeze(1).expand(-1, fingers, -1, -1)
        own = torch.eye(fingers, dtype=torch.bool)
        noise = torch.randn(x.shape, generator=torch.Generator().manual_seed(0))
        begin = torch.where(own[..., None], noise, x)
        drawn = prior.sample(begin, (~own).float(), 2, prior.context(state))
        error = self._scale.restore(drawn) - chunk.unsqueeze(1)  # (rows, draws, 8, fingers, 3)
        mine = torch.stack([error[:, k, :2, k] for k in range(fingers)], 1)
        still = torch.stack([chunk[:, :2, k] for k in range(fingers)], 1)
        return tuple(1000 * float(v.square().sum(-1).mean().sqrt()) for v in (mine, still))  # pyright: ignore[reportReturnType]

    def _readout_metrics(self, encoder: Encoder) -> dict[str, float]:
        rows = choose(self._continuing[1].nonzero().flatten(), 8 * self._config.held_out_rows, seed=1)
        batch = _gather(self._tune, rows, self._continuing[1], 0.0)
        metrics = {}
        truth = (batch.loads_later > CONTACT_FORCE).flatten()
        for name, history in {"": batch.history, "_no_touch": batch.history.without_touch()}.items():
            log_loads, later, log_forces = encoder.readout(encoder(history))
            if not name:
                right = batch.forces.norm(dim=-1).log1p()
                metrics["slow_force_unexplained"] = _unexplained(log_forces, right)
            metrics[f"contact_later_auc{name}"] = roc_auc(later.flatten(), truth)
            metrics[f"log_load_error{name}"] = float((log_loads - batch.loads.log1p()).abs().mean())
        codes = torch.bincount(encoder.slow(batch.history)[1].long()).double()
        share = codes[codes > 0] / codes.sum()
        metrics["slow_perplexity"] = float((-(share * share.log()).sum()).exp())
        return metrics


def part(controller: DexFlexController) -> nn.Module:
    """Return what of a controller this stage decides."""
    return nn.ModuleDict({name: controller.get_submodule(name) for name in _PARTS})


def flow_times(
    fingers: int, rows: int, n_flow: int, own_share: float, clean_share: float
) -> tuple[Tensor, Tensor]:
    """Draw flow times and step sizes, each (rows, 1, fingers); sizes of the first `n_flow` rows are 0.

    Times are dense near the noise, Beta(1, 1.5); steps and their starts fill the triangle evenly.
    """
    own = torch.rand(rows, 1, 1) < own_share
    u, v = (torch.where(own, torch.rand(rows, 1, fingers), torch.rand(rows, 1, 1)) for _ in range(2))
    t, size = LAST_TIME * (1 - u.pow(1 / 1.5)), torch.zeros(rows, 1, fingers)
    size[n_flow:] = v[n_flow:]
    t[n_flow:] = u[n_flow:] * (1 - v[n_flow:])
    clean = own & (torch.rand(rows, 1, fingers) < clean_share)
    return t.masked_fill(clean, 1.0), size.masked_fill(clean, 0.0)


def flow_losses(
    prior: Prior,
    average: Prior,
    state: State,
    average_state: State,
    chunk: Tensor,
    t: Tensor,
    size: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the flow-matching and the self-consistency loss of a batch, which together are a mean.

    Args:
        prior: In training.
        average: Its moving average, the teacher of consistency.
        state: Encoded states.
        average_state: The last of these states, encoded by the average; these rows train consistency.
        chunk: Normalised data. Shape (batch, 1, fingers, horizon * 3).
        t: Flow times; a finger at 1 is shown as it is and has no loss. Shape (batch, 1, fingers).
        size: Step sizes. Shape (batch, 1, fingers).
    """
    rows, n_consistent = len(chunk), len(average_state.body)
    n_flow = rows - n_consistent
    x = (1 - t)[..., None] * torch.randn_like(chunk) + t[..., None] * chunk
    target = (chunk - x) / (1 - t).clamp(min=1 - LAST_TIME)[..., None]
    if n_consistent:
        target[n_flow:] = _two_half_steps(average, average_state, x[n_flow:], t[n_flow:], size[n_flow:] / 2)
    moving = (t < 1).float()
    error = (prior.velocity(x, t, size, prior.context(state)) - target).square().mean(-1)
    error = (error * moving).sum((1, 2)) / moving.sum((1, 2)).clamp(min=1)
    return error[:n_flow].sum() / rows, error[n_flow:].sum() / rows


@torch.no_grad()
def _two_half_steps(prior: Prior, state: State, x: Tensor, t: Tensor, half: Tensor) -> Tensor:
    """Return the mean velocity over two steps of the given size, (batch, 1, fingers)."""
    context = prior.context(state)
    first = prior.velocity(x, t, half, context)
    second = prior.velocity(x + half[..., None] * first, t + half, half, context)
    return (first + second) / 2


def force_losses(forces: Forces, target: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """Return the robust error of forces where a finger should press, and the entropy of whether it should.

    Args:
        forces: From the decoder.
        target: In the distal links' frames [N]. Shape (batch, fingers, 3).
        scale: Unit of the error [N].
    """
    pressing = target.norm(dim=-1) > CONTACT_FORCE
    error = (forces.vector - target)[pressing] / scale
    force = functional.smooth_l1_loss(error, torch.zeros_like(error), beta=0.3)
    entropy = functional.binary_cross_entropy_with_logits(forces.pressing, pressing.float())
    return torch.nan_to_num(force), entropy


def force_metrics(forces: Forces, target: Tensor) -> dict[str, float]:
    """Return errors of forces where a finger should press, and the AUC of whether it should.

    In size [N], in direction [deg], and as the share of the variance that is not explained.
    """
    pressing = target.norm(dim=-1) > CONTACT_FORCE
    found, wanted = forces.vector[pressing], target[pressing]
    cosine = functional.cosine_similarity(found, wanted, dim=-1)
    size = (found.norm(dim=-1) - wanted.norm(dim=-1)).abs()
    return {
        "force_size_error": float(size.mean()),
        "force_direction_deg": float(torch.rad2deg(cosine.clamp(-1, 1).acos()).mean()),
        "force_unexplained": _unexplained(found, wanted),
        "pressing_auc": roc_auc(forces.pressing.flatten(), pressing.flatten()),
    }


def _unexplained(found: Tensor, truth: Tensor) -> float:
    """Return the share of the variance over rows that is not explained."""
    return float((found - truth).square().sum() / (truth - truth.mean(0)).square().sum())


def _networks(network: nn.Module) -> tuple[Encoder, Prior, Decoder]:
    encoder, prior, decoder = (network.get_submodule(name) for name in _PARTS[:3])
    assert isinstance(encoder, Encoder)
    assert isinstance(prior, Prior)
    assert isinstance(decoder, Decoder)
    return encoder, prior, decoder


def _gather(data: CorpusData, rows: Tensor, continuing: Tensor, draft_share: float) -> Batch:
    known = continuing[rows]
    later = torch.where(known, rows + DRAFT_HORIZON, rows)
    loads, plan = data.columns["loads"], data.plan(rows)
    shown = torch.rand(len(rows), 1, 1, 1) < draft_share
    executed = torch.where(shown, data.draft(rows), plan) if draft_share else plan
    return Batch(
        data.history(rows), plan, executed, data.local_forces(rows), loads[rows], loads[later], known
    )
