"""The hand-written rule of the first round: a baseline for drafts that command into the object."""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, Measured, check_draft
from lerobot_dexflex.interfaces.contact_projection import (
    PAST_DRAFTS,
    WINDOW,
    Grasp,
    ProjectionSettings,
    project_draft,
)
from lerobot_dexflex.interfaces.grip import loads_of
from lerobot_dexflex.interfaces.raw import MEANING
from lerobot_dexflex.interfaces.touch_watch import TouchWatch

RUNAWAY = 0.03
"""The commanded fingertips stay this close to the measured ones [m]: one that is not followed must not run
away, or nothing that is asked later would show for long."""


class _Memory(NamedTuple):
    """What is remembered of a row, newest first."""

    command: Tensor  # Commanded fingertips [m], (batch, fingers, 3).
    loads: Tensor  # (batch, WINDOW, fingers)
    drafts: Tensor  # First displacements, (batch, PAST_DRAFTS, fingers, 3).


class ProjectionInterface(CommandedInterface):
    """Keep commanded fingertips, which hold the squeeze, and move them by the contact projection.

    A draft is read as the displacements that it asks of the commanded fingertips, so only a source that
    commands into the object keeps its grip: one of motion asks to take the squeeze back. With a gain, squeeze
    and motion shrink together: they are not apart here. Satisfies `Interface`.

    Args:
        hand: The hand that it serves.
        settings: Of the projection.
    """

    name: str = "projection"

    def __init__(self, hand: Hand, settings: ProjectionSettings | None = None) -> None:
        super().__init__(hand)
        self.settings = settings or ProjectionSettings()
        self._touch = TouchWatch(hand)
        self._memory: _Memory | None = None
        self._forgotten: Tensor | None = None

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        self._touch.reset(mask)
        if mask is None or self._memory is None or self._forgotten is None:
            self._memory = self._forgotten = None
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._forgotten.device)
        self._forgotten = self._forgotten | mask

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the joint targets of the projected command; see `Interface.step`."""
        with self.all_or_nothing(self._touch):
            measured = self._hand.look(observation)
            rows = len(measured.joints)
            checked = check_draft(draft, (self.hand.n_fingers, 3), rows, MEANING)
            touch = self._touch.look(observation, rows)
            loads = loads_of(self.hand, touch.tactile).to(measured.joints)
            return self._project(measured, checked, loads, touch.missing).to(draft.dtype)

    def _project(self, measured: Measured, draft: Tensor, loads: Tensor, missing: Tensor) -> Tensor:
        tips = measured.tips
        command, past, drafts = self._recall(tips, loads)
        asked = torch.diff(tips[:, None] + draft, dim=1, prepend=command[:, None])
        grasp = Grasp(measured.joints, tips, past, missing, drafts)
        lead = command + project_draft(self.hand, asked, grasp, self.settings) - tips
        lead = lead * (RUNAWAY / lead.norm(dim=-1, keepdim=True).clamp(min=RUNAWAY))
        joints = self.move(measured, lead)
        self._memory = _Memory(tips + lead, past, torch.cat([asked[:, :1], drafts[:, :-1]], 1))
        return joints

    def _recall(self, tips: Tensor, loads: Tensor) -> _Memory:
        """Return the memory with this step's loads; that of new rows begins with what is measured now."""
        still = tips[:, None].expand(-1, PAST_DRAFTS, -1, -1) * 0.0
        begun = _Memory(tips, loads[:, None].expand(-1, WINDOW, -1), still)
        if self._memory is None or self._forgotten is None:
            self._forgotten = torch.zeros(len(tips), dtype=torch.bool, device=tips.device)
            return begun
        kept = self._memory._replace(loads=torch.cat([loads[:, None], self._memory.loads[:, :-1]], 1))
        new, self._forgotten = self._forgotten, torch.zeros_like(self._forgotten)
        pairs = zip(begun, kept, strict=True)
        return _Memory(*[torch.where(new.view(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs])


def make_projection(hand: Hand, **gains: float) -> ProjectionInterface:
    """Build the interface from the words of a method's name; see `ProjectionSettings`."""
    return ProjectionInterface(hand, ProjectionSettings(**gains))
