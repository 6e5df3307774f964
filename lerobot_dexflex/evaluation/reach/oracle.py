"""An upper bound for selection: our own candidates, tried out in the simulator before one is executed."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from lerobot_dexflex.commands.loop import Slot
from lerobot_dexflex.controller import DexFlexController, SelectionSettings, State
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.trials import try_out
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface
from lerobot_dexflex.interfaces.explanation import Choice
from lerobot_dexflex.interfaces.learned import Sensed, shared_controller
from lerobot_dexflex.interfaces.plan import Plan

Reference = Literal["draft", "clean"]

FEW = SelectionSettings(n_pure=3, n_seeded=4, n_finger=8, include_draft=True)
"""Sixteen candidates: an episode takes half a minute instead of several."""


class OracleInterface(DexFlexInterface):
    """Choose the candidate whose true outcome is best and that is nearest to a reference. `Privileged`.

    It shows what better consequence prediction and scoring could still give with the same candidates and the
    same grip.

    Args:
        hand: The hand that it serves.
        controller: Proposes the candidates and supplies the grip.
        reference: Near to what: the draft; or the operator's clean plan.
        moving: Steps of a chunk that are tried before holding still: 8 asks what the whole chunk would do,
            2 what is executed of it.
        settings: How candidates are proposed; `FEW` if None.

    Raises:
        DexFlexError: If the reference is unknown, or `moving` is not in [1, 8].
    """

    name: str = "oracle"

    def __init__(
        self,
        hand: Hand,
        controller: DexFlexController,
        reference: Reference = "draft",
        moving: int = DRAFT_HORIZON,
        settings: SelectionSettings | None = None,
    ) -> None:
        if reference not in ("draft", "clean"):
            raise DexFlexError(f"`reference` must be 'draft' or 'clean'. Got {reference!r}.")
        if moving not in range(1, DRAFT_HORIZON + 1):
            raise DexFlexError(
                f"`moving` must be a number of steps from 1 to {DRAFT_HORIZON}. Got {moving!r}."
            )
        super().__init__(hand, controller, settings or FEW)
        self._reference, self._moving = reference, moving
        self._slots: Sequence[Slot | None] = ()

    def see(self, slots: Sequence[Slot | None]) -> None:
        """Look at the running episodes; see `Privileged`."""
        self._slots = slots

    def _choose(self, sensed: Sensed, state: State) -> Plan:
        draft = sensed.draft.draft
        candidates = self.controller.propose(state, draft.float(), self.settings)
        chunks = candidates.chunks.double()
        chunks[:, 0] = draft  # Executed as it came, not as float32 has it.
        forces = self._forces(sensed, state, sensed.history, draft).numpy()
        rows = len(chunks)
        best = torch.zeros(rows, dtype=torch.int64)
        cost, grasp = torch.zeros(2, rows), torch.zeros(2, rows)
        lost = torch.zeros(2, rows, self.hand.n_fingers)
        due = self._plan.age >= self.settings.prefix if self._plan is not None else None
        for k, slot in enumerate(self._slots):
            if slot is None or slot.guidance is None or (due is not None and not due[k]):
                continue
            wanted = draft[k].numpy()
            if self._reference == "clean":
                wanted = slot.guidance.tips - slot.state.tips
            held = forces[k].copy()
            tried = try_out(slot, chunks[k].numpy(), wanted, lambda _, held=held: held, self._moving)
            best[k] = int(np.argmin(tried.cost))
            shown = [int(best[k]), 0]  # The draft is the first candidate.
            for series, values in zip((cost, lost, grasp), tried, strict=True):
                series[:, k] = torch.from_numpy(values[shown].astype(float))
        slip = torch.zeros(rows, self.hand.n_fingers)
        choice = Choice(
            candidates.branch[best], -cost[0], -cost[1], lost[0], lost[1], slip, slip, grasp[0], grasp[1]
        )
        targets = sensed.measured.tips[:, None] + chunks[torch.arange(rows), best]
        return Plan(targets, choice, torch.zeros_like(best))


def make_oracle(hand: Hand, controller: str | Path, **options: Any) -> OracleInterface:
    """Build the oracle from the words of a method's name.

    Args:
        hand: The hand that it serves.
        controller: Folder of the controller that proposes.
        **options: `reference` and `moving` of `OracleInterface`, others of `SelectionSettings`.
    """
    tried = {key: options.pop(key) for key in ("reference", "moving") if key in options}
    settings = replace(FEW, **options)
    return OracleInterface(hand, shared_controller(Path(controller)), settings=settings, **tried)
