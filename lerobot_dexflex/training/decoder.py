"""Fourth stage: the decoder, toward the joint command that the clean label would have given."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.decoder import Decoder
from lerobot_dexflex.controller.encoder import State
from lerobot_dexflex.hand.kinematics import solve_fingertips
from lerobot_dexflex.training.bank import ProposalBank
from lerobot_dexflex.training.corpus_data import CorpusData
from lerobot_dexflex.training.fit import FitConfig, Stage

_ROWS_AT_ONCE = 256


@dataclass
class DecoderConfig:
    """Losses and data of the fourth stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=8_000))
    clean_share: float = 0.3
    """Share of rows whose chunk is the clean one instead of the chosen one."""
    latent_dropout: float = 0.1
    """Share of rows whose predicted latent is hidden."""


class Chosen(NamedTuple):
    """One chunk per state of a bank, and what is left to correct."""

    chunk: Tensor  # normalised (rows, chunk_width)
    latent: Tensor  # (rows, latent_width)
    residual: (
        Tensor  # label's joint command minus the chunk's by inverse kinematics, bounded (rows, 16) [rad]
    )


class Batch(NamedTuple):
    """States, chosen chunks and what to add to their joint commands."""

    state: State
    chosen: Chosen


class DecoderStage(Stage):
    """Train `controller.decoder` on what the frozen prior, world model and score choose."""

    name = "decoder"

    def __init__(
        self,
        controller: DexFlexController,
        train: tuple[CorpusData, ProposalBank],
        tune: tuple[CorpusData, ProposalBank],
        config: DecoderConfig,
    ) -> None:
        self._config = config
        self._bank, self._tune_bank = train[1], tune[1]
        self._picked = choose_chunks(controller, *train)
        self._clean = choose_chunks(controller, *train, clean=True)
        self._tune_picked = choose_chunks(controller, *tune)
        super().__init__(controller.decoder)

    def batch(self) -> Batch:
        """Draw states with the chosen or the clean chunk."""
        config = self._config
        index = torch.randint(len(self._bank), (config.fit.batch_size,))
        clean = torch.rand(len(index), 1) < config.clean_share
        hide = torch.rand(len(index), 1) < config.latent_dropout
        pairs = zip(self._clean, self._picked, strict=True)
        chosen = Chosen(*[torch.where(clean, a[index].float(), b[index].float()) for a, b in pairs])
        chosen = chosen._replace(latent=chosen.latent.masked_fill(hide, 0))
        return Batch(self._bank.state(index), chosen)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return a robust error of the residual, in units of its bound."""
        network, chosen = self.network, batch.chosen
        assert isinstance(network, Decoder)
        residual = network(batch.state, chosen.chunk, chosen.latent)
        error = (residual - chosen.residual) / network.bound
        loss = functional.smooth_l1_loss(error, torch.zeros_like(error), beta=0.1)
        return loss, {"mrad": 1000 * network.bound * error.detach().square().mean().sqrt()}

    def evaluate(self) -> dict[str, float]:
        """Return the rms joint error before and after the correction [mrad]."""
        network, chosen = self.average, self._tune_picked
        assert isinstance(network, Decoder)
        index, metrics = torch.arange(len(self._tune_bank)), {}
        residual = network(self._tune_bank.state(index), chosen.chunk.float(), chosen.latent.float())
        proxy = self._tune_bank.tensors["proxy"]
        for name, rows in {"given": ~proxy, "proxy": proxy}.items():
            if rows.any():
                before = chosen.residual[rows]
                metrics[f"{name}_before_mrad"] = 1000 * float(before.square().mean().sqrt())
                after = before - residual[rows]
                metrics[f"{name}_after_mrad"] = 1000 * float(after.square().mean().sqrt())
        return metrics


@torch.no_grad()
def choose_chunks(
    controller: DexFlexController, data: CorpusData, bank: ProposalBank, clean: bool = False
) -> Chosen:
    """Return the best-scored (or the clean) chunk of every state in a bank.

    Args:
        controller: With all other parts trained.
        data: The split that the bank was drawn from.
        bank: States and proposals.
        clean: Take the clean chunk instead.
    """
    parts = []
    for index in torch.arange(len(bank)).split(_ROWS_AT_ONCE):
        state, draft = bank.state(index), bank.get("draft", index)
        chunks = bank.get("clean", index).unsqueeze(1) if clean else bank.get("chunks", index)
        latent = controller.dream(state, chunks).latent
        score = controller.score(state, draft, bank.get("past", index), chunks, latent)
        rows, best = torch.arange(len(index)), score.argmax(1)
        chunk = chunks[rows, best]
        residual = _residual(data, bank.tensors["row"][index], chunk, controller.config.residual_bound)
        parts.append((controller.scale.normalize(chunk), latent[rows, best].half(), residual))
    return Chosen(*[torch.cat(values) for values in zip(*parts, strict=True)])


def _residual(data: CorpusData, rows: Tensor, chunk: Tensor, bound: float) -> Tensor:
    columns = data.columns
    target = columns["command"][rows].double() + chunk[:, 0].double()
    raw = solve_fingertips(target, columns["joint_targets"][rows - 1].double())
    return (columns["label_joints"][rows].double() - raw).clamp(-bound, bound).float()
