"""Bridge late drafts and bound wild ones."""

from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.commanded_hand import check_draft

DRAFT_HEALTH = ("ok", "late", "clipped")
"""What a draft can be; `DraftReading.health` holds indices into it."""
LARGEST_DISPLACEMENT = 0.015
"""Displacements are clipped here, per axis and control step [m]: 0.3 m/s, twice what 99 % of the experts'
steps stay below."""

_OK, _LATE, _CLIPPED = range(len(DRAFT_HEALTH))
_MEANING = f"displacements of the four commanded fingertips [m] over {DRAFT_HORIZON} control steps"


class DraftReading(NamedTuple):
    """A draft that is safe to compute with."""

    draft: Tensor
    """Displacements [m], float64. Shape (batch, 8, 4, 3)."""
    health: Tensor
    """Index into `DRAFT_HEALTH`. Shape (batch,)."""


class DraftWatch:
    """Judge drafts, row by row, remembering the last one.

    A late draft (None) is replaced by the rest of the last one, followed by rest: the hand goes on for at
    most 7 steps and then holds. A draft far outside of what a hand can do is clipped.
    """

    def __init__(self) -> None:
        self._last: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the drafts of the rows in `mask`, shape (batch,), or of all."""
        if mask is None or self._last is None:
            self._last = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._last.device)
        self._last = self._last.masked_fill(mask[:, None, None, None], 0.0)

    def look(self, draft: Tensor | None, like: Tensor) -> DraftReading:
        """Judge this step's draft; call it once per control step.

        Args:
            draft: A draft that `checked_draft` accepts.
            like: Any tensor of shape (batch, ...) on the right device.
        """
        rows = len(like)
        if self._last is None:
            shape = (rows, DRAFT_HORIZON, 4, 3)
            self._last = torch.zeros(shape, dtype=torch.float64, device=like.device)
        health = torch.zeros(rows, dtype=torch.int64, device=like.device)
        if draft is None:
            current = torch.cat([self._last[:, 1:], torch.zeros_like(self._last[:, :1])], 1)
            health = health + _LATE
        else:
            wild = (draft.abs() > LARGEST_DISPLACEMENT).flatten(1).any(1)
            current = draft.double().clamp(-LARGEST_DISPLACEMENT, LARGEST_DISPLACEMENT)
            health = torch.where(wild, _CLIPPED, health)
        self._last = current
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
            "Cut it, or repeat its last displacement where there is no plan."
        )
    return checked
