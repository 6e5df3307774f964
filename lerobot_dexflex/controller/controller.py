"""Draft, dream, select: the frozen composition of all parts of the controller."""

import copy
from pathlib import Path
from typing import Any, NamedTuple

import torch
from huggingface_hub import ModelCard, ModelHubMixin
from torch import Tensor, nn

from lerobot_dexflex.controller import checkpoint
from lerobot_dexflex.controller.card import controller_card
from lerobot_dexflex.controller.chunks import DRAFT, FINGER, PURE, SEEDED, Candidates, ChunkScale, distance_to
from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.decoder import Decoder, Forces
from lerobot_dexflex.controller.encoder import Encoder, State
from lerobot_dexflex.controller.finite import check_output
from lerobot_dexflex.controller.history import History
from lerobot_dexflex.controller.layout import SharedLayout
from lerobot_dexflex.controller.prior import Prior
from lerobot_dexflex.controller.score import Score
from lerobot_dexflex.controller.settings import SelectionSettings
from lerobot_dexflex.controller.splitter import Splitter
from lerobot_dexflex.controller.view import View, view_of
from lerobot_dexflex.controller.world_model import WorldModel
from lerobot_dexflex.hands import Hand


class Dream(NamedTuple):
    """Predicted outcomes of candidates."""

    latent: Tensor
    """Predicted z a horizon later. Shape (batch, candidates, latent_width)."""
    contact_loss: Tensor
    """Probability that a finger loaded now is unloaded then. Shape (batch, candidates, fingers)."""
    slip: Tensor
    """Probability that a finger loaded now slips along the object. Shape (batch, candidates, fingers)."""
    grasp_loss: Tensor
    """Probability that the grasp is lost within the horizon. Shape (batch, candidates)."""


class Selection(NamedTuple):
    """A decision and what led to it."""

    chunk: Tensor
    """The chosen chunk [m]. Shape (batch, horizon, fingers, 3)."""
    best: Tensor
    """The best candidate. Shape (batch,)."""
    score: Tensor
    """Shape (batch, candidates)."""
    candidates: Candidates
    dream: Dream


class DexFlexController(nn.Module, ModelHubMixin):
    """Propose chunks from the prior, predict their outcomes, score them, supply the grip of the best.

    Each step raises `DexFlexError` if its network puts out NaN or infinity.

    Args:
        config: What the controller is for and how large; the default is untrained but usable.
        record: How it was trained, for the card: plain values.
    """

    def __init__(self, config: ControllerConfig | None = None, record: dict[str, Any] | None = None) -> None:
        super().__init__()
        self.config = config or ControllerConfig()
        self.record = record or {}
        self._view: View | None = None
        self.scale = ChunkScale(self.config.n_fingers)
        self.encoder = Encoder(self.config)
        self.prior = Prior(self.config)
        self.world_model = WorldModel(self.config)
        self.ranker = Score(self.config)
        self.decoder = Decoder(self.config)
        self.splitter = Splitter(self.config)

    def serving(self, hand: Hand, source: str = "The controller") -> "DexFlexController":
        """Return this controller, its networks shared, as one that is told and tells in terms of a hand.

        Until then one of several hands speaks in those of its layout, as training does. A controller of one
        hand always speaks in that hand's: it is returned itself.

        Args:
            hand: One of `config.hand`.
            source: Which controller it is, for the message.

        Raises:
            DexFlexError: If it was not trained for the hand; see `ControllerConfig.check`.
        """
        self.config.check(hand, source)
        layout = self.config.layout
        if not isinstance(layout, SharedLayout):
            return self
        served = copy.copy(self)
        served._view = view_of(layout, hand)
        return served

    def encode(self, history: History, slow: Tensor | None = None) -> State:
        """Encode the past, once per control step.

        Args:
            history: Raw units; `history.without_touch()` and `.without_slow()` hide parts of it.
            slow: A slow token from `encode_slow` up to 8 steps ago, shape (batch, slow_width); None computes
                it anew.
        """
        state = self.encoder(self._view.history(history) if self._view else history, slow)
        check_output("encoder", state.features)
        return state

    def encode_slow(self, history: History) -> Tensor:
        """Return the slow token, to be refreshed every 8 steps. Shape (batch, slow_width)."""
        seen = self._view.history(history) if self._view else history
        return check_output("encoder", self.encoder.slow_token(seen))

    def squeeze(self, state: State, draft: Tensor) -> Tensor:
        """Return what of every step of a draft commands into the object [m], about zero if it says motion.

        Shape (batch, fingers, 3).

        Args:
            state: The encoded states.
            draft: Shape (batch, horizon, fingers, 3) [m].
        """
        return self._tell(check_output("splitter", self.splitter(state, self._see(draft))))

    def propose(
        self, state: State, draft: Tensor, settings: SelectionSettings, noise: Tensor | None = None
    ) -> Candidates:
        """Draw candidate chunks: the draft first, then from the prior, from noisy drafts, finger by finger.

        Args:
            state: The encoded states.
            draft: Shape (batch, horizon, fingers, 3) [m].
            settings: How many and from where.
            noise: Standard normal, shape (batch or 1, drawn candidates, fingers, horizon * 3); None draws it
                from `settings.seed`, the same for all rows and steps, so that choices do not flicker.
        """
        start, branch = _starts(settings, self.config.n_fingers)
        parts = [draft.unsqueeze(1)] if settings.include_draft else []
        if len(start):
            if noise is None:
                generator = torch.Generator().manual_seed(settings.seed)
                shape = (1, *start.shape, self.config.finger_chunk_width)
                noise = torch.randn(shape, generator=generator)
            level = start.to(draft)[..., None]  # (candidates, fingers, 1)
            origin = self.scale.normalize(self._see(draft)).unsqueeze(1)
            begin = (1 - level) * noise.to(draft) + level * origin
            drawn = self.prior.sample(begin, start.to(draft), settings.nfe, self.prior.context(state))
            parts.append(self._tell(check_output("prior", self.scale.restore(drawn))))
        own = torch.full((int(settings.include_draft),), DRAFT)
        return Candidates(torch.cat(parts, 1), torch.cat([own, branch]))

    def dream(self, state: State, candidates: Candidates | Tensor) -> Dream:
        """Predict the outcome of candidates; chunks are (batch, candidates, horizon, fingers, 3) [m]."""
        prediction = self.world_model(state, self.scale.normalize(self._see(_chunks(candidates))))
        for output in prediction:
            check_output("world model", output)
        latent, *logits = prediction
        contact_loss, slip, grasp_loss = (logit.sigmoid() for logit in logits)
        if self._view:
            contact_loss, slip = self._view.own(contact_loss), self._view.own(slip)
        return Dream(latent, contact_loss, slip, grasp_loss)

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
            draft: Shape (batch, horizon, fingers, 3) [m].
            drafts_history: First steps of earlier drafts [m]. Shape (batch, 8, fingers, 3).
            candidates: What to rank.
            latent: `Dream.latent` of the candidates; zeros hide it.
        """
        normalize = self.scale.normalize
        past, chunks = self.scale.normalize_past(self._see(drafts_history)), self._see(_chunks(candidates))
        scores = self.ranker(state, normalize(self._see(draft)), past, normalize(chunks), latent)
        return check_output("score", scores)

    def decode(self, state: State, chunk: Tensor) -> Forces:
        """Return the forces that the fingers should exert while a chunk is executed.

        Args:
            state: The encoded states.
            chunk: Shape (batch, horizon, fingers, 3) [m].
        """
        forces = self.decoder(state, self.scale.normalize(self._see(chunk)))
        for output in forces:
            check_output("decoder", output)
        if self._view is None:
            return forces
        return Forces(self._view.own_local(forces.vector), self._view.own(forces.pressing))

    def select(
        self,
        state: State,
        draft: Tensor,
        drafts_history: Tensor,
        settings: SelectionSettings,
        noise: Tensor | None = None,
    ) -> Selection:
        """Propose, dream, score and choose; arguments as for `propose`."""
        candidates = self.propose(state, draft, settings, noise)
        chunks = candidates.chunks
        dream = self.dream(state, candidates)
        branch = candidates.branch.to(draft.device)
        if settings.use_score:
            latent = dream.latent if settings.use_dream else torch.zeros_like(dream.latent)
            score = self.score(state, draft, drafts_history, candidates, latent)
        else:
            score = -distance_to(chunks, draft)
            if chunks.shape[1] > 1:  # The draft itself would always win.
                score = score.masked_fill(branch == DRAFT, -torch.inf)
        follows = (branch == DRAFT) | (branch == SEEDED)
        best = (score + settings.hysteresis * follows).argmax(1)
        rows = torch.arange(len(best), device=best.device)
        return Selection(chunks[rows, best], best, score, candidates, dream)

    def _see(self, motion: Tensor) -> Tensor:
        """Return motion (..., fingers, 3) of the hand that is served as the networks see it."""
        return self._view.vectors(motion) if self._view else motion

    def _tell(self, motion: Tensor) -> Tensor:
        """Return the networks' motion (..., slots, 3) as that of the hand that is served."""
        return self._view.own_vectors(motion) if self._view else motion

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
            DexFlexError: If there is none, it is damaged, or it is for an unknown hand or another rate or
                format.
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


def _starts(settings: SelectionSettings, fingers: int) -> tuple[Tensor, Tensor]:
    """Return flow times at which fingers of drawn candidates start (candidates, fingers), and branches."""
    levels = settings.levels or (0.0,)
    seeded = [[levels[k % len(levels)]] * fingers for k in range(settings.n_seeded)]
    alone = []
    for k in range(settings.n_finger):
        one = [settings.others_level] * fingers
        one[k % fingers] = settings.finger_levels[k // fingers % len(settings.finger_levels)]
        alone.append(one)
    counts = torch.tensor([settings.n_pure, settings.n_seeded, settings.n_finger])
    start = torch.tensor([[0.0] * fingers] * settings.n_pure + seeded + alone).reshape(-1, fingers)
    return start, torch.tensor([PURE, SEEDED, FINGER]).repeat_interleave(counts)
