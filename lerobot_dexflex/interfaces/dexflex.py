"""Draft, dream, select: execute what the controller foresees to keep contact and still follow the draft."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lerobot_dexflex.controller import DexFlexController, History, Selection, SelectionSettings, State
from lerobot_dexflex.controller.projection import project_draft
from lerobot_dexflex.conventions import STATE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.explanation import Choice
from lerobot_dexflex.interfaces.learned import LearnedInterface, Sensed
from lerobot_dexflex.interfaces.plan import Plan
from lerobot_dexflex.interfaces.registry import INTERFACES

SLOW_PERIOD = 8
"""Control steps for which a slow token is kept."""


class DexFlexInterface(LearnedInterface):
    """Choose among the draft, the prior's chunks and chunks around the draft by their dreamed outcome.

    Receding horizon: `settings.prefix` displacements of a chosen chunk are executed, then it chooses again.
    Between two choices no network runs; the correction of the joints stays that of the choice. Noise is the
    same in every row and step, so a hand does in a batch what it does alone. Satisfies `Interface`; a draft
    of None is one that came too late.

    Args:
        controller: The controller, its folder or hub id; the shipped one if None.
        settings: How candidates are proposed and chosen.
    """

    name: str = "dexflex"

    def __init__(
        self,
        controller: DexFlexController | str | Path | None = None,
        settings: SelectionSettings | None = None,
    ) -> None:
        super().__init__(controller)
        self.settings = settings or SelectionSettings()
        self._plan: Plan | None = None
        self._slow: Tensor | None = None
        self._slow_age: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        if mask is None or self._plan is None or self._slow_age is None:
            self._plan = self._slow = self._slow_age = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._slow_age.device)
        self._plan = self._plan.expired(mask, self.settings.prefix)
        self._slow_age = self._slow_age.masked_fill(mask, SLOW_PERIOD)

    @torch.no_grad()
    def step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        """Return the joint targets of the chosen chunk's next displacement; see `Interface.step`."""
        with self._all_or_nothing():
            targets = self._step(observation, draft)
        return targets.to(observation[STATE].dtype if draft is None else draft.dtype)

    def _step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        sensed = self._sense(observation, draft)
        if self._slow_age is None:
            rows, device = len(sensed.joints), sensed.joints.device
            self._slow_age = torch.full((rows,), SLOW_PERIOD, dtype=torch.int64, device=device)
        if self._plan is None:
            plan = self._choose(sensed)
        else:
            plan = self._plan
            due = plan.age >= self.settings.prefix
            if due.any():
                plan = plan.renewed(due, self._choose(sensed))
        self._plan, self._slow_age = plan.older(), self._slow_age + 1
        return self._execute(sensed, plan.displacement().double(), plan.residual.double(), plan.choice)

    def _choose(self, sensed: Sensed) -> Plan:
        draft = sensed.draft.draft.float()
        history = sensed.history if self.settings.use_touch else sensed.history.without_touch()
        state = self._encode(history)
        past, repaired = sensed.drafts_history, None
        if self.settings.project:
            repaired = project_draft(draft, history, past, self.settings.projection)
        selection = self.controller.select(state, draft, past, self.settings, repaired=repaired)
        choice = self._explain(state, draft, past, selection)
        age = torch.zeros(len(draft), dtype=torch.int64, device=draft.device)
        return Plan(selection.chunk, selection.residual, choice, age)

    def _encode(self, history: History) -> State:
        """Encode the past; slow tokens are renewed in the rows where they are `SLOW_PERIOD` steps old."""
        if not self.settings.use_slow:
            history = history.without_slow()
        assert self._slow_age is not None
        old = self._slow_age >= SLOW_PERIOD
        if self._slow is None:
            self._slow = self.controller.encode_slow(history)
        elif old.any():
            self._slow = torch.where(old[:, None], self.controller.encode_slow(history), self._slow)
        self._slow_age = self._slow_age.masked_fill(old, 0)
        return self.controller.encode(history, self._slow)

    def _explain(self, state: State, draft: Tensor, drafts_history: Tensor, selection: Selection) -> Choice:
        """Compare the chosen candidate with the raw draft, which is dreamed also where it is no candidate."""
        rows, best = torch.arange(len(draft), device=draft.device), selection.best
        dream, score = selection.dream, selection.score
        raw_dream, raw_score = dream, score
        if not self.settings.include_draft:
            alone = draft.unsqueeze(1)
            raw_dream = self.controller.dream(state, alone)
            latent = raw_dream.latent if self.settings.use_dream else torch.zeros_like(raw_dream.latent)
            raw_score = self.controller.score(state, draft, drafts_history, alone, latent)
        return Choice(
            branch=selection.candidates.branch.to(best.device)[best],
            score=score[rows, best],
            draft_score=raw_score[:, 0],
            contact_loss=dream.contact_loss[rows, best],
            draft_contact_loss=raw_dream.contact_loss[:, 0],
            grasp_loss=dream.grasp_loss[rows, best],
            draft_grasp_loss=raw_dream.grasp_loss[:, 0],
        )


def make_dexflex(controller: str | Path | None, ablation: str = "", **options: Any) -> DexFlexInterface:
    """Build the interface from the words of a method's name.

    Args:
        controller: Folder or hub id; the shipped one if None.
        ablation: See `ablated`.
        **options: Of `SelectionSettings`.
    """
    return DexFlexInterface(controller, ablated(SelectionSettings(**options), ablation))


def ablated(settings: SelectionSettings, ablation: str) -> SelectionSettings:
    """Return the settings without one part; every ablation chooses among as many candidates.

    Raises:
        DexFlexError: If there is no such ablation.
    """
    match ablation:
        case "":
            return settings
        case "noscore":
            return replace(settings, use_score=False)
        case "notouch":
            return replace(settings, use_touch=False)
        case "noconsequence":
            return replace(settings, use_dream=False)
        case "noslow":
            return replace(settings, use_slow=False)
        case "nopure":
            return replace(settings, n_pure=0, n_seeded=settings.n_pure + settings.n_seeded)
        case "noseeded":
            total = settings.n_candidates
            return replace(settings, n_pure=total, n_seeded=0, include_draft=False, project=False)
    raise DexFlexError(f"Unknown ablation {ablation!r}. Valid: {', '.join(INTERFACES['dexflex'].ablations)}.")
