"""What the networks are given of the past: a few frames, a slow window and the recent drafts."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.controller.config import (
    DRAFT_HISTORY,
    FRAMES,
    SLOW_SAMPLES,
    SLOW_STRIDE,
)
from lerobot_dexflex.conventions import FINGERTIPS, GRAVITY, STATE, TACTILE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import finger_frames
from lerobot_dexflex.hands import Hand

SLOW_OFFSETS = tuple(range(0, SLOW_STRIDE * SLOW_SAMPLES, SLOW_STRIDE))
"""Steps back of the slow window's samples."""


class History(NamedTuple):
    """A batch of states with their past, in raw units; frames are newest first."""

    joints: Tensor
    """Measured joints at `FRAMES` [rad]. Shape (batch, 4, joints)."""
    fingertips: Tensor
    """Measured fingertips at `FRAMES`, palm frame [m]. Shape (batch, 4, fingers, 3)."""
    gravity: Tensor
    """Unit vector in the palm frame. Shape (batch, 3)."""
    tactile: Tensor
    """Taxel forces at `FRAMES` [N]. Shape (batch, 4, fingers, *taxels)."""
    tactile_missing: Tensor
    """Fingers whose touch is not known. Shape (batch, fingers), bool."""
    slow_loads: Tensor
    """Total force per finger in the slow window [N]. Shape (batch, 8, fingers)."""
    slow_fingertips: Tensor
    """Measured fingertips in the slow window [m]. Shape (batch, 8, fingers, 3)."""
    slow_missing: Tensor
    """Rows whose slow token is hidden. Shape (batch,), bool."""
    rotations: Tensor
    """Orientations of the distal links now, palm frame; in a layout of several hands, of the pads in its own.
    Shape (batch, fingers, 3, 3)."""
    geometry: Tensor
    """What a controller of several hands is told of each finger, see `SharedLayout.geometry`.
    Shape (batch, fingers, numbers)."""

    def without_touch(self) -> "History":
        """Return the same history with the touch of every finger missing."""
        return self._replace(tactile_missing=torch.ones_like(self.tactile_missing))

    def without_slow(self) -> "History":
        """Return the same history with the slow token hidden."""
        return self._replace(slow_missing=torch.ones_like(self.slow_missing))


def past_rows(rows: Tensor, step: Tensor, offsets: tuple[int, ...]) -> Tensor:
    """Return the rows of a recording that lie some steps back, clamped at the episode's first.

    Args:
        rows: Rows of a recording whose episodes are contiguous. Shape (batch,).
        step: Step of each row within its episode, 0 is the first. Shape (batch,).
        offsets: Steps back.

    Returns:
        Shape (batch, offsets).
    """
    back = torch.tensor(offsets, device=rows.device)
    return rows[:, None] - torch.minimum(back, step.long()[:, None])


class _Frame(NamedTuple):
    joints: Tensor  # (rows, joints)
    fingertips: Tensor  # (rows, fingers, 3)
    tactile: Tensor  # (rows, fingers, *taxels)
    missing: Tensor  # (rows, fingers)
    loads: Tensor  # (rows, fingers)


class HistoryBuffer:
    """Gather `History` at run time, one observation at a time, for a batch of hands.

    A row that was just reset is filled with its first observation. Rows are never written in place:
    LeRobot acts under `torch.inference_mode`, whose tensors may not be modified outside of it.

    Args:
        hand: Whose past.
    """

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self._fast: _Frame | None = None
        self._slow_loads: Tensor | None = None
        self._slow_tips: Tensor | None = None
        self._drafts: Tensor | None = None
        self._fresh: Tensor | None = None

    @property
    def drafts(self) -> Tensor:
        """First steps of the drafts before this one, oldest first [m]. Shape (batch, 8, fingers, 3)."""
        if self._drafts is None:
            raise DexFlexError("There are no drafts before the first observation; call `observe` first.")
        return self._drafts

    def reset(self, mask: Tensor | None = None) -> None:
        """Forget the past of the rows in `mask` (batch,), or of all."""
        if mask is None or self._fresh is None:
            self.__init__(self.hand)
            return
        mask = torch.as_tensor(mask, dtype=torch.bool, device=self._fresh.device)
        if mask.shape != self._fresh.shape:
            raise DexFlexError(
                f"`mask` must be one bool per row, shape {tuple(self._fresh.shape)}. Got {tuple(mask.shape)}."
            )
        self._fresh = self._fresh | mask

    def observe(self, observation: Mapping[str, Tensor]) -> History:
        """Take in the newest observation and return the history that ends with it.

        Args:
            observation: In raw units: `observation.state` (batch, >= joints), the hand's joints last [rad],
                `observation.fingertips` (batch, fingers * 3) [m], `observation.gravity` (batch, 3) and, where
                there is touch, `observation.tactile` (batch, fingers * taxels) [N]. A finger with NaN is
                taken as missing.

        Raises:
            DexFlexError: If a key is missing or misshapen, or the batch changed without a reset.
        """
        frame = _read_frame(self.hand, observation)
        rows = len(frame.joints)
        if self._fresh is None:
            self._fresh = torch.ones(rows, dtype=torch.bool, device=frame.joints.device)
            self._drafts = frame.joints.new_zeros(rows, DRAFT_HISTORY, self.hand.n_fingers, 3)
        assert self._drafts is not None
        fresh = self._fresh
        if rows != len(fresh):
            raise DexFlexError(
                f"The batch changed from {len(fresh)} to {rows} hands without a reset; "
                "call `reset()` before a batch of another size."
            )
        past: list[Tensor | None] = list(self._fast) if self._fast else [None] * len(frame)
        length = FRAMES[-1] + 1
        fast = [_push(ring, new, fresh, length) for ring, new in zip(past, frame, strict=True)]
        self._fast = _Frame(*fast)
        window = SLOW_OFFSETS[-1] + 1
        self._slow_loads = _push(self._slow_loads, frame.loads, fresh, window)
        self._slow_tips = _push(self._slow_tips, frame.fingertips, fresh, window)
        self._drafts = torch.where(fresh[:, None, None, None], 0.0, self._drafts)
        self._fresh = torch.zeros_like(fresh)
        frames, slow = list(FRAMES), list(SLOW_OFFSETS)
        return History(
            joints=self._fast.joints[:, frames],
            fingertips=self._fast.fingertips[:, frames],
            gravity=observation[GRAVITY].float(),
            tactile=self._fast.tactile[:, frames],
            tactile_missing=self._fast.missing[:, frames].any(1),
            slow_loads=self._slow_loads[:, slow],
            slow_fingertips=self._slow_tips[:, slow],
            slow_missing=torch.zeros_like(fresh),
            rotations=finger_frames(self.hand, frame.joints).distal_rotation,
            geometry=frame.joints.new_zeros(rows, self.hand.n_fingers, 0),
        )

    def remember(self, draft: Tensor) -> None:
        """Take in the draft of this step, after it was used; its first step joins `drafts`.

        Args:
            draft: Shape (batch, horizon, fingers, 3) [m].
        """
        self._drafts = torch.cat([self.drafts[:, 1:], draft[:, :1].to(self.drafts)], 1)


def _push(ring: Tensor | None, newest: Tensor, fresh: Tensor, length: int) -> Tensor:
    """Put the newest entry first; rows that are fresh become copies of it. Shape (rows, length, ...)."""
    filled = newest.unsqueeze(1).expand(-1, length, *newest.shape[1:])
    if ring is None:
        return filled
    rolled = torch.cat([newest.unsqueeze(1), ring[:, :-1]], 1)
    return torch.where(fresh.view(-1, *[1] * newest.ndim), filled, rolled)


def _read_frame(hand: Hand, observation: Mapping[str, Tensor]) -> _Frame:
    fingers, taxels = hand.n_fingers, hand.n_fingers * math.prod(hand.taxels)
    values: dict[str, Tensor] = {}
    for key, width in {STATE: hand.n_joints, FINGERTIPS: fingers * 3, GRAVITY: 3}.items():
        if key not in observation:
            raise DexFlexError(f"The observation lacks '{key}'. Got keys: {sorted(observation)}.")
        value = observation[key]
        fits = value.ndim == 2 and (value.shape[1] == width or (key == STATE and value.shape[1] > width))
        if not fits:
            raise DexFlexError(
                f"'{key}' of the hand '{hand.name}' must have shape (batch, {width}). "
                f"Got {tuple(value.shape)}."
            )
        values[key] = value[:, -width:].float()
        if not torch.isfinite(values[key]).all():
            raise DexFlexError(f"'{key}' holds NaN or infinity; hold the last reading or stop the hand.")
    joints, tips = values[STATE], values[FINGERTIPS]
    tactile = observation.get(TACTILE)
    if tactile is None:
        tactile = joints.new_full((len(joints), taxels), torch.nan)
    if tactile.numel() != len(joints) * taxels:
        raise DexFlexError(f"'{TACTILE}' must have shape (batch, {taxels}) [N]. Got {tuple(tactile.shape)}.")
    tactile = tactile.float().reshape(-1, fingers, *hand.taxels)
    missing = ~torch.isfinite(tactile).flatten(2).all(-1)
    tactile = torch.where(missing[..., None, None], 0.0, tactile)
    return _Frame(joints, tips.reshape(-1, fingers, 3), tactile, missing, tactile.sum((-1, -2)))
