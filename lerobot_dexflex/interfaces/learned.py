"""What learned interfaces share: they see the past, doubt touch and drafts, move the hand and say why."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.controller import DexFlexController, History, HistoryBuffer, State
from lerobot_dexflex.conventions import FINGERTIPS, TACTILE
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hand.kinematics import pads
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.commanded_hand import CommandedInterface, Measured
from lerobot_dexflex.interfaces.controller_folder import find_controller
from lerobot_dexflex.interfaces.draft_watch import DRAFT_HEALTH, DraftReading, DraftWatch, checked_draft
from lerobot_dexflex.interfaces.explanation import Choice, Explanation, relative_change
from lerobot_dexflex.interfaces.free_fingers import FreeFingers
from lerobot_dexflex.interfaces.grip import loads_of
from lerobot_dexflex.interfaces.touch_watch import TouchReading, TouchWatch

LEAST_SQUEEZE = 0.001
"""A finger whose draft is found to command less far into the object only moves [m]: on drafts of motion
0.4 mm (rms over the fingers) are found by mistake."""


class Sensed(NamedTuple):
    """Everything known at a control step."""

    measured: Measured
    """Where the hand is."""
    history: History
    """What the networks see of the past."""
    drafts_history: Tensor
    """First steps of earlier drafts, oldest first [m]. Shape (batch, 8, fingers, 3)."""
    draft: DraftReading
    """Once `LearnedInterface._without_squeeze` has seen it, motion alone."""
    touch: TouchReading
    squeeze: Tensor
    """What of the draft was found to be squeeze [m]. Shape (batch, fingers, 3)."""


class LearnedInterface(CommandedInterface):
    """An interface around a frozen controller.

    A finger whose touch is missing, frozen or saturated is shown to the networks as missing; a late draft is
    bridged and a wild one clipped. Fingers that hold nothing, or are to let go, follow the draft (see
    `FreeFingers`). `explanation` tells.

    Args:
        hand: The hand that it serves.
        controller: The controller, its folder or hub id; the shipped one if None. A folder's is loaded once
            and shared: interfaces keep what they remember beside it.

    Raises:
        DexFlexError: If the controller is missing, damaged or one of another hand.
    """

    def __init__(self, hand: Hand, controller: DexFlexController | str | Path | None) -> None:
        super().__init__(hand)
        source = "The controller"
        if not isinstance(controller, DexFlexController):
            folder = find_controller(hand, controller)
            source, controller = f"The controller in {folder}", shared_controller(folder)
        self.controller = controller.eval().serving(hand, source)
        self._touch, self._drafts, self._past = TouchWatch(hand), DraftWatch(), HistoryBuffer(hand)
        self._fingers = FreeFingers()
        self._explanation: Explanation | None = None

    @property
    def explanation(self) -> Explanation | None:
        """Why the last step was what it was; None before the first."""
        return self._explanation

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        super().reset(mask)
        for part in (self._touch, self._drafts, self._past, self._fingers):
            part.reset(mask)
        if mask is None:
            self._explanation = None

    @property
    def _parts(self) -> tuple[Any, ...]:
        """Everything that remembers, beside the hand."""
        return (self._touch, self._drafts, self._past, self._fingers)

    def _move(self, device: torch.device) -> None:
        """Bring the networks to a device."""
        self.controller.to(device)

    def _sense(self, observation: Mapping[str, Tensor], draft: Tensor | None) -> Sensed:
        """Take in this step's observation and draft."""
        measured = self._hand.look(observation)
        joints, tips = measured
        checked = checked_draft(self.hand, draft, len(joints))
        if self.controller.scale.scale.device != joints.device:  # Asking each weight costs a millisecond.
            self._move(joints.device)
        touch = self._touch.look(observation, len(joints))
        seen = {**observation, TACTILE: touch.tactile, FINGERTIPS: tips.flatten(1)}
        history = self._past.observe(seen)._replace(tactile_missing=touch.missing)
        reading = self._drafts.look(checked, tips)
        return Sensed(measured, history, self._past.drafts, reading, touch, torch.zeros_like(tips))

    def _without_squeeze(self, sensed: Sensed, history: History, state: State, use_splitter: bool) -> Sensed:
        """Read the draft as motion, with the splitter as what is left of it without upstream's squeeze.

        Call it once per step. A finger that does not touch, or is not led inward, does not squeeze. Without
        the splitter it stays as it is, bit for bit. `history` is the one that `state` was encoded from.
        """
        draft = sensed.draft.draft
        if not use_splitter:
            self._past.remember(draft)
            return sensed
        found = self.controller.squeeze(state, draft.float()).double()
        touching = (loads_of(self.hand, sensed.touch.tactile) > CONTACT_FORCE) | history.tactile_missing
        inward = pads(self.hand, sensed.measured.joints)[1]
        pressed = torch.minimum((found * inward).sum(-1), (draft[:, 0] * inward).sum(-1))
        squeezes = touching & (pressed > LEAST_SQUEEZE)
        squeeze = torch.where(squeezes[..., None], found, 0.0)
        motion = draft - squeeze[:, None]
        self._past.remember(motion)
        return sensed._replace(draft=sensed.draft._replace(draft=motion), squeeze=squeeze)

    def _free(self, sensed: Sensed, history: History) -> Tensor:
        """Return which fingers follow their draft as it came, (batch, fingers); call it once per step."""
        late = sensed.draft.health == DRAFT_HEALTH.index("late")
        inward = pads(self.hand, sensed.measured.joints)[1]
        return self._fingers.look(sensed.draft.draft, self._loads(sensed, history), inward, late)

    def _loads(self, sensed: Sensed, history: History) -> Tensor:
        """Return the felt load of each finger [N], NaN where touch is missing. Shape (batch, fingers)."""
        loads = loads_of(self.hand, sensed.touch.tactile).double()
        return loads.masked_fill(history.tactile_missing, torch.nan)

    def _explain(
        self,
        sensed: Sensed,
        motion: Tensor,
        free: Tensor,
        forces: Tensor | None = None,
        choice: Choice | None = None,
    ) -> None:
        """Note why the motion [m] (batch, fingers, 3) was executed, of fingers of which some were free."""
        change = relative_change(self.gain * motion, sensed.draft.draft[:, 0])
        touch, draft, names = sensed.touch.health, sensed.draft.health, self.hand.finger_names
        self._explanation = Explanation(names, change, touch, draft, sensed.squeeze, free, forces, choice)


def shared_controller(folder: Path) -> DexFlexController:
    """Return the controller of a folder, loaded once per process as long as its files stay as they are."""
    return _loaded(folder.resolve(), file_stamps(folder))


def file_stamps(folder: Path) -> tuple[tuple[str, int, int], ...]:
    """Return name, time of the last change [ns] and size of the files in a controller's folder."""
    return tuple((f.name, f.stat().st_mtime_ns, f.stat().st_size) for f in sorted(folder.iterdir()))


@functools.cache
def _loaded(folder: Path, stamps: tuple[tuple[str, int, int], ...]) -> DexFlexController:
    del stamps
    return DexFlexController.from_pretrained(folder)
