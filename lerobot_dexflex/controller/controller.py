"""Draft, dream, select: the frozen composition of all parts of the controller."""

from pathlib import Path
from typing import Any, NamedTuple

import torch
from huggingface_hub import ModelCard, ModelHubMixin
from torch import Tensor, nn

from lerobot_dexflex.controller import checkpoint
from lerobot_dexflex.controller.card import controller_card
from lerobot_dexflex.controller.chunks import (
    CONTACT,
    DRAFT,
    PURE,
    SEEDED,
    Candidates,
    ChunkScale,
    distance_to,
    seed_chunks,
)
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.decoder import HAND_DOFS, Decoder
from lerobot_dexflex.controller.encoder import Encoder, State
from lerobot_dexflex.controller.finite import check_output
from lerobot_dexflex.controller.history import History
from lerobot_dexflex.controller.prior import Prior
from lerobot_dexflex.controller.score import Score
from lerobot_dexflex.controller.settings import SelectionSettings
from lerobot_dexflex.controller.world_model import WorldModel


class Dream(NamedTuple):
    """Predicted outcomes of candidates."""

    latent: Tensor
    """Predicted z a horizon later. Shape (batch, candidates, latent_width)."""
    contact_loss: Tensor
    """Probability that a finger loaded now is unloaded then. Shape (batch, candidates, 4)."""
    grasp_loss: Tensor
    """Probability that the grasp is lost within the horizon. Shape (batch, candidates)."""


class Selection(NamedTuple):
    """A decision and what led to it."""

    chunk: Tensor
    """The chosen chunk, output gain applied [m]. Shape (batch, horizon, 4, 3)."""
    residual: Tensor
    """Correction to be added to the inverse kinematics of its first step [rad]. Shape (batch, 16)."""
    best: Tensor
    """The best candidate. Shape (batch,)."""
    score: Tensor
    """Shape (batch, candidates)."""
    candidates: Candidates
    dream: Dream


class DexFlexController(nn.Module, ModelHubMixin):
    """Propose chunks from the prior, predict their outcomes, score them, decode the best.

    Each step raises `DexFlexError` if its network puts out NaN or infinity.

    Args:
        config: What the controller is for and how large; the default is untrained but usable.
        record: How it was trained, for the card: plain values.
    """

    def __init__(self, config: ControllerConfig | None = None, record: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.config = config or ControllerConfig()
        self.record = record or {}
        self.scale = ChunkScale()
        self.encoder = Encoder(self.config)
        self.prior = Prior(self.config)
        self.world_model = WorldModel(self.config)
        self.ranker = Score(self.config)
        self.decoder = Decoder(self.config)

    def encode(self, history: History, slow: Tensor | None = None) -> State:
        """Encode the past, once per control step.

        Args:
            history: Raw units; `history.without_touch()` and `.without_slow()` hide parts of it.
            slow: A slow token from `encode_slow` up to 8 steps ago, shape (batch, slow_width); None computes
                it anew.
        """
        state = self.encoder(history, slow)
        check_output("encoder", state.features)
        return state

    def encode_slow(self, history: History) -> Tensor:
        """Return the slow token, to be refreshed every 8 steps. Shape (batch, slow_width)."""
        return check_output("encoder", self.encoder.slow_token(history))

    def propose(
        self,
        state: State,
        draft: Tensor,
        drafts_history: Tensor,
        settings: SelectionSettings,
        noise: Tensor | None = None,
        repaired: Tensor | None = None,
    ) -> Candidates:
        """Draw candidate chunks: the draft first, then from the prior, from noisy drafts, its projection.

        Args:
            state: The encoded states.
            draft: Shape (batch, horizon, 4, 3) [m].
            drafts_history: First displacements of earlier drafts, oldest first [m]. Shape (batch, 8, 4, 3).
            settings: How many and from where.
            noise: Standard normal, shape (batch or 1, n_pure + n_seeded, chunk_width); None draws it from
                `settings.seed`, the same for all rows and steps, so that choices do not flicker.
            repaired: The draft's contact projection, if it takes part; draft-seeded candidates then start
                from it. Shape (batch, horizon, 4, 3) [m].
        """
        n_pure, n_seeded = settings.n_pure, settings.n_seeded
        branch = torch.tensor([DRAFT] * settings.include_draft + [PURE] * n_pure + [SEEDED] * n_seeded)
        parts = [draft.unsqueeze(1)] if settings.include_draft else []
        if n_pure + n_seeded:
            if noise is None:
                generator = torch.Generator().manual_seed(settings.seed)
                noise = torch.randn(1, n_pure + n_seeded, self.config.chunk_width, generator=generator)
            noise = noise.to(draft).expand(len(draft), -1, -1)
            starts, begin = noise[:, :n_pure], [0.0] * n_pure
            if n_seeded:
                levels = [settings.levels[k % len(settings.levels)] for k in range(n_seeded)]
                level = draft.new_tensor(levels)[:, None]
                origin = draft if repaired is None else repaired
                seeds = self.scale.normalize(seed_chunks(origin, drafts_history, settings))
                starts = torch.cat([starts, (1 - level) * noise[:, n_pure:] + level * seeds], 1)
                begin = begin + levels
            steps = [max(1, round(settings.nfe * (1 - t))) for t in begin]
            drawn = self.prior.sample(starts, begin, steps, self.prior.context(state))
            parts.append(check_output("prior", self.scale.restore(drawn)))
        if repaired is not None:
            parts.append(repaired.unsqueeze(1))
            branch = torch.cat([branch, torch.tensor([CONTACT])])
        return Candidates(torch.cat(parts, 1), branch)

    def dream(self, state: State, candidates: Candidates | Tensor) -> Dream:
        """Predict the outcome of candidates; chunks have the shape (batch, candidates, horizon, 4, 3) [m]."""
        prediction = self.world_model(state, self.scale.normalize(_chunks(candidates)))
        for output in prediction:
            check_output("world model", output)
        return Dream(prediction.latent, prediction.contact_loss.sigmoid(), prediction.grasp_loss.sigmoid())

    def score(
        self,
        state: State,
        draft: Tensor,
        drafts_history: Tensor,
        candidates: Candidates | Tensor,
        latent: Tensor,
    ) -> Tensor:
        """Score candidates, higher is better. Shape (batch, candidates).

        Args:
            state: The encoded states.
            draft: Shape (batch, horizon, 4, 3) [m].
            drafts_history: Shape (batch, 8, 4, 3) [m].
            candidates: What to rank.
            latent: `Dream.latent` of the candidates; zeros hide it.
        """
        normalize = self.scale.normalize
        scores = self.ranker(
            state, normalize(draft), normalize(drafts_history), normalize(_chunks(candidates)), latent
        )
        return check_output("score", scores)

    def decode(self, state: State, chunk: Tensor, latent: Tensor) -> Tensor:
        """Return the correction of the raw joint targets of a chunk [rad]. Shape (batch, 16).

        Args:
            state: The encoded states.
            chunk: Shape (batch, horizon, 4, 3) [m].
            latent: Its predicted outcome, zeros hide it. Shape (batch, latent_width).
        """
        return check_output("decoder", self.decoder(state, self.scale.normalize(chunk), latent))

    def select(
        self,
        state: State,
        draft: Tensor,
        drafts_history: Tensor,
        settings: SelectionSettings,
        noise: Tensor | None = None,
        repaired: Tensor | None = None,
    ) -> Selection:
        """Propose, dream, score, choose and decode; arguments as for `propose`."""
        candidates = self.propose(state, draft, drafts_history, settings, noise, repaired)
        chunks = candidates.chunks
        dream = self.dream(state, candidates)
        latent = dream.latent if settings.use_dream else torch.zeros_like(dream.latent)
        branch = candidates.branch.to(draft.device)
        if settings.use_score:
            score = self.score(state, draft, drafts_history, candidates, latent)
            score = score + settings.contact_bias * (branch == CONTACT)
        else:
            score = -distance_to(chunks, draft)
            if chunks.shape[1] > 1:  # The draft itself would always win.
                score = score.masked_fill(branch == DRAFT, -torch.inf)
        best = score.argmax(1)
        if settings.temperature > 0:
            weights = (score / settings.temperature).softmax(1)
            chunk = (weights[..., None, None, None] * chunks).sum(1)
            outcome = (weights[..., None] * latent).sum(1)
        else:
            rows = torch.arange(len(best), device=best.device)
            chunk, outcome = chunks[rows, best], latent[rows, best]
        residual = chunk.new_zeros(len(chunk), HAND_DOFS)
        if settings.use_residual:
            residual = self.decode(state, chunk, outcome)
        return Selection(settings.output_gain * chunk, residual, best, score, candidates, dream)

    def part_sizes(self) -> dict[str, int]:
        """Return the number of parameters of each part."""
        parts = {name: sum(p.numel() for p in part.parameters()) for name, part in self.named_children()}
        return {name: count for name, count in parts.items() if count}

    @classmethod
    def from_pretrained(  # pyright: ignore[reportIncompatibleMethodOverride]
        cls,
        pretrained_model_name_or_path: str | Path,
        *,
        force_download: bool = False,
        token: str | bool | None = None,
        cache_dir: str | Path | None = None,
        local_files_only: bool = False,
        revision: str | None = None,
    ) -> "DexFlexController":
        """Load a controller from a folder or the Hugging Face Hub, frozen and in evaluation mode.

        Args:
            pretrained_model_name_or_path: Folder with `config.json` and `model.safetensors`, or a Hub name.
            force_download: Download again even if cached.
            token: Access token of the Hub.
            cache_dir: Where downloads are kept.
            local_files_only: Never download.
            revision: Branch, tag or commit on the Hub.

        Raises:
            DexFlexError: If there is none, it is damaged, or it is for another hand, rate or format.
        """
        files = checkpoint.find(
            pretrained_model_name_or_path,
            force_download=force_download,
            token=token,
            cache_dir=cache_dir,
            local_files_only=local_files_only,
            revision=revision,
        )
        controller = cls(ControllerConfig.load(files.config), checkpoint.read_record(files.record))
        checkpoint.load_weights(controller, files.weights)
        return controller.eval().requires_grad_(False)

    def _save_pretrained(self, save_directory: Path) -> None:
        checkpoint.save(self, self.config, self.record, save_directory)
        self.generate_model_card().save(save_directory / "README.md")

    def generate_model_card(self, *args: Any, **kwargs: Any) -> ModelCard:
        """Return the card, written from the configuration and the training record."""
        del args, kwargs  # The mixin's, unused.
        return controller_card(self.config, self.part_sizes(), self.record)


def _chunks(candidates: Candidates | Tensor) -> Tensor:
    return candidates.chunks if isinstance(candidates, Candidates) else candidates
