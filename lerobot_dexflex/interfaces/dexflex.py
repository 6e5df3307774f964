"""Draft, dream, select, grip: execute what is foreseen to keep contact and still follows the draft."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lerobot_dexflex.controller import DexFlexController, History, Selection, SelectionSettings, State
from lerobot_dexflex.conventions import STATE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import finger_frames, pads
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.explanation import Choice
from lerobot_dexflex.interfaces.grip import NO_SERVO, Grip, centres_of_pressure
from lerobot_dexflex.interfaces.learned import LearnedInterface, Sensed
from lerobot_dexflex.interfaces.plan import Plan
from lerobot_dexflex.interfaces.registry import INTERFACES

SLOW_PERIOD = 8
"""Control steps for which a slow token is kept."""


class DexFlexInterface(LearnedInterface):
    """Choose among the draft, the prior's chunks and chunks around the draft; supply the grip of the chosen.

    Receding horizon: `settings.prefix` steps of a chosen chunk are executed, then it chooses again; the grip
    is decoded anew in every step. Free fingers follow the draft instead, without grip. Noise is the same in
    every row and step, so a hand does in a batch what it does alone. Satisfies `Interface`; a draft of None
    is one that came too late.

    Args:
        hand: The hand that it serves.
        controller: The controller, its folder or hub id; the shipped one if None.
        settings: How candidates are proposed and chosen.
    """

    name: str = "dexflex"

    def __init__(
        self,
        hand: Hand,
        controller: DexFlexController | str | Path | None = None,
        settings: SelectionSettings | None = None,
    ) -> None:
        super().__init__(hand, controller)
        self.settings = settings or SelectionSettings()
        self._grip = Grip(hand, NO_SERVO)
        self._plan: Plan | None = None
        self._slow: Tensor | None = None
        self._slow_age: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        self._grip.reset(mask)
        if mask is None or self._plan is None or self._slow_age is None:
            self._plan = self._slow = self._slow_age = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._slow_age.device)
        self._plan = self._plan.expired(mask, self.settings.prefix)
        self._slow_age = self._slow_age.masked_fill(mask, SLOW_PERIOD)

    @torch.no_grad()
    def step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        """Return the joint targets of the chosen chunk's next step and its grip; see `Interface.step`."""
        with self.all_or_nothing(*self._parts):
            targets = self._step(observation, draft)
        return targets.to(observation[STATE].dtype if draft is None else draft.dtype)

    @property
    def _parts(self) -> tuple[Any, ...]:
        return (*super()._parts, self._grip)

    def _step(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Tensor:
        sensed = self._sense(observation, draft)
        tips = sensed.measured.tips
        if self._slow_age is None:
            shape, device = (len(tips),), tips.device
            self._slow_age = torch.full(shape, SLOW_PERIOD, dtype=torch.int64, device=device)
        history = sensed.history if self.settings.use_touch else sensed.history.without_touch()
        state = self._encode(history)
        sensed = self._without_squeeze(sensed, history, state, self.settings.use_splitter)
        if self._plan is None:
            plan = self._choose(sensed, state)
        else:
            plan = self._plan
            due = plan.age >= self.settings.prefix
            if due.any():
                plan = plan.renewed(due, self._choose(sensed, state))
        self._plan, self._slow_age = plan.older(), self._slow_age + 1
        free = self._free(sensed, history)
        ahead = torch.where(free[:, None, :, None], sensed.draft.draft, plan.motion(tips))
        forces = self._forces(sensed, state, history, ahead).masked_fill(free[..., None], 0.0)
        motion = ahead[:, 0]
        joints = self._press(sensed, history, motion, forces)
        self._explain(sensed, motion, free, forces, plan.choice)
        return joints

    def _choose(self, sensed: Sensed, state: State) -> Plan:
        draft, past = sensed.draft.draft.float(), sensed.drafts_history
        selection = self.controller.select(state, draft, past, self.settings)
        choice = self._compare(state, draft, past, selection)
        age = torch.zeros(len(draft), dtype=torch.int64, device=draft.device)
        chunk = selection.chunk.double()
        if self.settings.include_draft:  # Executed as it came, not as float32 has it.
            obeyed = (selection.best == 0)[:, None, None, None]
            chunk = torch.where(obeyed, sensed.draft.draft, chunk)
        return Plan(sensed.measured.tips[:, None] + chunk, choice, age)

    def _forces(self, sensed: Sensed, state: State, history: History, ahead: Tensor) -> Tensor:
        """Return the forces of the grip in the palm frame [N]. Shape (batch, fingers, 3), float64."""
        joints = sensed.measured.joints
        if self.settings.grip:
            holding = self._grip.feel(self._loads(sensed, history))
            return self.settings.grip * pads(self.hand, joints)[1] * holding[..., None]
        local = self.controller.decode(state, ahead.float()).grip().double()
        rotation = finger_frames(self.hand, joints).distal_rotation
        return (rotation @ local[..., None]).squeeze(-1)

    def _press(self, sensed: Sensed, history: History, motion: Tensor, forces: Tensor) -> Tensor:
        joints = sensed.measured.joints
        loads = self._loads(sensed, history)
        if not self.settings.grip:
            self._grip.feel(loads)
        felt = sensed.touch.tactile.double().unflatten(1, (self.hand.n_fingers, -1))
        felt = felt.masked_fill(history.tactile_missing[..., None], 0.0).flatten(1)
        points = centres_of_pressure(self.hand, joints, felt)
        torques, push = self._grip.exert(joints, forces, loads, points)
        return self.move(sensed.measured, motion, push, torques)

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

    def _compare(self, state: State, draft: Tensor, drafts_history: Tensor, selection: Selection) -> Choice:
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
            slip=dream.slip[rows, best],
            draft_slip=raw_dream.slip[:, 0],
            grasp_loss=dream.grasp_loss[rows, best],
            draft_grasp_loss=raw_dream.grasp_loss[:, 0],
        )


def make_dexflex(
    hand: Hand, controller: str | Path | None, ablation: str = "", **options: Any
) -> DexFlexInterface:
    """Build the interface from the words of a method's name.

    Args:
        hand: The hand that it serves.
        controller: Folder or hub id; the shipped one if None.
        ablation: See `ablated`.
        **options: Of `SelectionSettings`.
    """
    return DexFlexInterface(hand, controller, ablated(SelectionSettings(**options), ablation))


def ablated(settings: SelectionSettings, ablation: str) -> SelectionSettings:
    """Return the settings without one part; ablations of the branches choose among as many candidates.

    Raises:
        DexFlexError: If there is no such ablation.
    """
    match ablation:
        case "":
            return settings
        case "noselection":
            return replace(settings, n_pure=0, n_seeded=0, n_finger=0, include_draft=True)
        case "noscore":
            return replace(settings, use_score=False)
        case "notouch":
            return replace(settings, use_touch=False)
        case "noconsequence":
            return replace(settings, use_dream=False)
        case "noslow":
            return replace(settings, use_slow=False)
        case "nopure":
            return replace(settings, n_pure=0, n_seeded=settings.n_seeded + settings.n_pure)
        case "nofinger":
            return replace(settings, n_seeded=settings.n_seeded + settings.n_finger, n_finger=0)
        case "noseeded":
            return replace(
                settings, n_pure=settings.n_candidates, n_seeded=0, n_finger=0, include_draft=False
            )
        case "nogrip":
            return replace(settings, grip=_PRESS)
    raise DexFlexError(f"Unknown ablation {ablation!r}. Valid: {', '.join(INTERFACES['dexflex'].ablations)}.")


_PRESS = 1.5
"""Force of `press` that the ablation `nogrip` has instead of the decoder's [N]."""
