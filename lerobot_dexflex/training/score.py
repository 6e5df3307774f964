"""Third stage: the score, contrastively over proposals of the frozen prior."""

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.controller.chunks import distance_to
from lerobot_dexflex.controller.controller import DexFlexController
from lerobot_dexflex.controller.encoder import State
from lerobot_dexflex.controller.score import Score
from lerobot_dexflex.training.bank import ProposalBank
from lerobot_dexflex.training.fit import FitConfig, Stage

_NORMAL_BATCH = 64


@dataclass
class ScoreConfig:
    """Losses and data of the third stage."""

    fit: FitConfig = field(default_factory=lambda: FitConfig(steps=12_000, batch_size=_NORMAL_BATCH))
    tau_mm: float = 0.8
    """Distance from the clean chunk at which a candidate is clearly worse [mm]."""
    distance_steps: int = 2
    """First steps of a chunk that the distance looks at."""
    positive_share: float = 0.5
    """Share of rows that also hold the clean chunk itself."""
    n_hard: int = 2
    """Clean chunks of the batch's other states with the most similar drafts, as negatives."""
    latent_dropout: float = 0.1
    """Share of rows whose predicted latents are hidden."""
    outcome_weight: float = 1.0
    """Weight of the predicted logarithmic chance to keep the grasp in the soft labels."""


class Batch(NamedTuple):
    """Candidates to rank."""

    state: State
    draft: Tensor  # (batch, 8, fingers, 3) [m]
    past: Tensor  # (batch, 8, fingers, 3) [m]
    clean: Tensor  # (batch, 8, fingers, 3) [m]
    chunks: Tensor  # (batch, candidates, 8, fingers, 3) [m]
    absent: Tensor  # candidates that take no part (batch, candidates) bool
    hide_latent: Tensor  # (batch,) bool


class ScoreStage(Stage):
    """Train `controller.ranker` with soft labels by distance from the clean chunk."""

    name = "score"

    def __init__(
        self, controller: DexFlexController, train: ProposalBank, tune: ProposalBank, config: ScoreConfig
    ) -> None:
        self._controller, self._train, self._tune, self._config = controller, train, tune, config
        super().__init__(controller.ranker)

    def batch(self) -> Batch:
        """Draw states with their proposals; add the clean chunk and clean chunks of similar drafts."""
        config, bank = self._config, self._train
        index = torch.randint(len(bank), (config.fit.batch_size,))
        draft, clean = bank.get("draft", index), bank.get("clean", index)
        n_hard = min(config.n_hard, len(index) - 1)
        hard = clean[_similar(draft, n_hard)]  # (batch, n_hard, 8, fingers, 3)
        chunks = torch.cat([bank.get("chunks", index), hard, clean.unsqueeze(1)], 1)
        absent = torch.zeros(chunks.shape[:2], dtype=torch.bool)
        absent[:, -1] = torch.rand(len(index)) >= config.positive_share
        hide = torch.rand(len(index)) < config.latent_dropout
        return Batch(bank.state(index), draft, bank.get("past", index), clean, chunks, absent, hide)

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the cross-entropy between candidates by closeness and by score."""
        network, config = self.network, self._config
        assert isinstance(network, Score)
        distance = distance_to(batch.chunks, batch.clean, config.distance_steps)
        with torch.no_grad():
            dream = self._controller.dream(batch.state, batch.chunks)
            latent = dream.latent.masked_fill(batch.hide_latent[:, None, None], 0)
        closeness = -(distance / config.tau_mm).square() / 2
        if config.outcome_weight:
            closeness = closeness + config.outcome_weight * torch.log1p(-dream.grasp_loss.clamp(max=0.999))
        target = closeness.masked_fill(batch.absent, -torch.inf).softmax(1)
        score = self._score(network, batch, latent).masked_fill(batch.absent, -1e4)
        loss = -(target * score.log_softmax(1)).sum(1).mean()
        floor = -(target * target.clamp(min=1e-12).log()).sum(1).mean()
        picked = distance.gather(1, score.argmax(1, keepdim=True)).mean()
        return loss, {"above_floor": (loss - floor).detach(), "picked_mm": picked}

    def evaluate(self) -> dict[str, float]:
        """Return the pick's distance from the plan, beside the draft's and the best one's [mm]."""
        network, bank, metrics = self.average, self._tune, {}
        assert isinstance(network, Score)
        for name, chosen in {"spoilt": bank.spoilt, "clean": ~bank.spoilt}.items():
            index = chosen.nonzero().flatten()
            if not len(index):
                continue
            batch = self._plain(bank, index)
            distance = distance_to(batch.chunks, batch.clean, self._config.distance_steps)
            latent = self._controller.dream(batch.state, batch.chunks).latent
            pick = self._picked(network, batch, latent)
            metrics[f"{name}_draft_mm"] = float(distance[:, 0].mean())
            metrics[f"{name}_best_mm"] = float(distance.amin(1).mean())
            metrics[f"{name}_picked_mm"] = float(distance.gather(1, pick).mean())
            metrics[f"{name}_obeyed"] = float((pick == 0).double().mean())
            blind = self._picked(network, batch, torch.zeros_like(latent))
            metrics[f"{name}_picked_no_dream_mm"] = float(distance.gather(1, blind).mean())
        return metrics

    def _plain(self, bank: ProposalBank, index: Tensor) -> Batch:
        chunks = bank.get("chunks", index)
        absent = torch.zeros(chunks.shape[:2], dtype=torch.bool)
        draft, past, clean = (bank.get(name, index) for name in ("draft", "past", "clean"))
        return Batch(bank.state(index), draft, past, clean, chunks, absent, absent[:, 0])

    def _score(self, network: Score, batch: Batch, latent: Tensor) -> Tensor:
        scale = self._controller.scale
        past = scale.normalize_past(batch.past)
        return network(batch.state, scale.normalize(batch.draft), past, scale.normalize(batch.chunks), latent)

    def _picked(self, network: Score, batch: Batch, latent: Tensor) -> Tensor:
        return self._score(network, batch, latent).argmax(1, keepdim=True)


def _similar(draft: Tensor, count: int) -> Tensor:
    """Return the rows whose first draft steps are nearest to each row's own. Shape (batch, count)."""
    first = draft[:, 0].flatten(1)
    return torch.cdist(first, first).fill_diagonal_(torch.inf).topk(count, largest=False).indices
