"""Bridge late drafts and bound wild ones."""

from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.commanded_hand import check_draft

DRAFT_HEALTH = ("ok", "late", "clipped")
"""What a draft can be; `DraftReading.health` holds indices into it."""
LARGEST_STEP, LARGEST_OFFSET = 0.03, 0.12
"""Drafts are clipped to so much per axis in their first step, and in any [m]: a hand cannot do more, and does
not reach farther."""

_OK, _LATE, _CLIPPED = range(len(DRAFT_HEALTH))
_MEANING = (
    f"where the four fingertips should be, minus where they are measured [m], over {DRAFT_HORIZON} steps"
)


class DraftReading(NamedTuple):
    """A draft that is safe to compute with."""

    draft: Tensor
    """Where tips should be, minus where they are measured [m], float64. Shape (batch, 8, 4, 3)."""
    health: Tensor
    """Index into `DRAFT_HEALTH`. Shape (batch,)."""


class DraftWatch:
    """Judge drafts, row by row, remembering where the last one led.

    A late draft (None) is replaced by the rest of the last one, followed by rest: the hand goes on for at
    most 7 steps and then stays where that ended. A draft far outside of what a hand can do is clipped.
    """

    def __init__(self) -> None:
        self._last: Tensor | None = None  # Positions [m] (batch, 8, 4, 3); NaN after a reset.

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the drafts of the rows in `mask`, shape (batch,), or of all."""
        if mask is None or self._last is None:
            self._last = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._last.device)
        self._last = self._last.masked_fill(mask[:, None, None, None], torch.nan)

    def look(self, draft: Tensor | None, tips: Tensor) -> DraftReading:
        """Judge this step's draft; call it once per control step.

        Args:
            draft: A draft that `checked_draft` accepts.
            tips: Measured fingertips [m], float64. Shape (batch, 4, 3).
        """
        here = tips[:, None]
        health = torch.zeros(len(tips), dtype=torch.int64, device=tips.device)
        if draft is None:
            last = here.expand(-1, DRAFT_HORIZON, -1, -1) if self._last is None else self._last
            left = torch.cat([last[:, 1:], last[:, -1:]], 1)
            current = torch.where(left.isnan(), 0.0, left - here)
            health = health + _LATE
        else:
            bound = draft.new_full((DRAFT_HORIZON, 1, 1), LARGEST_OFFSET, dtype=torch.float64)
            bound[0] = LARGEST_STEP
            wild = (draft.abs() > bound).flatten(1).any(1)
            current = torch.minimum(torch.maximum(draft.double(), -bound), bound)
            health = torch.where(wild, _CLIPPED, health)
        self._last = here + current
        return DraftReading(current, health)


def checked_draft(draft: Tensor | None, rows: int) -> Tensor | None:
    """Return the draft, or refuse it; None is a late draft and always fine.

    Raises:
        DexFlexError: If the draft has another shape than (rows, 8, 4, 3), NaN or infinity.
    """
    if draft is None:
        return None
    checked = check_draft(draft, (4, 3), rows, _MEANING)
    if draft.shape[1] != DRAFT_HORIZON:
        raise DexFlexError(
            f"The controller looks {DRAFT_HORIZON} control steps ahead; the draft has {draft.shape[1]}. "
            "Cut it, or repeat its last step where there is no plan."
        )
    return checked
