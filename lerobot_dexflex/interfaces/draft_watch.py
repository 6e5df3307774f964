"""Bridge late drafts and bound wild ones."""

from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.commanded_hand import check_draft
from lerobot_dexflex.interfaces.raw import MEANING

DRAFT_HEALTH = ("ok", "late", "clipped")
"""What a draft can be; `DraftReading.health` holds indices into it."""
FARTHEST, FASTEST = 0.06, 0.015
"""Drafts are clipped here, per axis: as far as this [m], or where so fast a motion gets [m per control
step]: 0.3 m/s, twice what 99 % of the experts' steps stay below. 99 % of what is asked by who
commands into an object stay below 60 mm."""

_OK, _LATE, _CLIPPED = range(len(DRAFT_HEALTH))


class DraftReading(NamedTuple):
    """A draft that is safe to compute with."""

    draft: Tensor
    """Where the fingertips should be, relative to where they are measured [m], float64. Shape
    (batch, 8, fingers, 3)."""
    health: Tensor
    """Index into `DRAFT_HEALTH`. Shape (batch,)."""


class DraftWatch:
    """Judge drafts, row by row, remembering where the last one led.

    A late draft (None) is replaced by the rest of the last one, wherever the hand is by now, and its end is
    held: the hand goes on for at most 7 steps. A draft far outside of what a hand can do is clipped.
    """

    def __init__(self) -> None:
        self._goals: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the drafts of the rows in `mask`, shape (batch,), or of all."""
        if mask is None or self._goals is None:
            self._goals = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._goals.device)
        # NaN marks a row without a past: if its first draft is late, it holds.
        self._goals = self._goals.masked_fill(mask[:, None, None, None], torch.nan)

    def look(self, draft: Tensor | None, tips: Tensor) -> DraftReading:
        """Judge this step's draft; call it once per control step.

        Args:
            draft: A draft that `checked_draft` accepts.
            tips: Measured fingertips [m], float64. Shape (batch, fingers, 3).
        """
        here = tips[:, None]
        health = torch.full((len(tips),), _OK, dtype=torch.int64, device=tips.device)
        steps = torch.arange(1, DRAFT_HORIZON + 1, dtype=torch.float64, device=tips.device)
        bound = (FASTEST * steps).clamp(min=FARTHEST).view(-1, 1, 1)
        if draft is None:
            goals = here.expand(-1, DRAFT_HORIZON, -1, -1) if self._goals is None else self._goals
            goals = torch.cat([goals[:, 1:], goals[:, -1:]], 1)
            draft, health = torch.where(goals.isnan(), here, goals) - here, health + _LATE
        else:
            wild = (draft.abs() > bound).flatten(1).any(1)
            health = torch.where(wild, _CLIPPED, health)
        current = draft.double().clamp(-bound, bound)
        self._goals = here + current
        return DraftReading(current, health)


def checked_draft(hand: Hand, draft: Tensor | None, rows: int) -> Tensor | None:
    """Return the draft, or refuse it; None is a late draft and always fine.

    Raises:
        DexFlexError: If the draft has another shape than (rows, 8, fingers, 3), NaN or infinity.
    """
    if draft is None:
        return None
    checked = check_draft(draft, (hand.n_fingers, 3), rows, MEANING)
    if draft.shape[1] != DRAFT_HORIZON:
        raise DexFlexError(
            f"The controller looks {DRAFT_HORIZON} control steps ahead; the draft has {draft.shape[1]}. "
            "Cut it, or repeat its last step where there is no plan."
        )
    return checked
