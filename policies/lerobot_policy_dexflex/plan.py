"""What a plan holds: one row of numbers per control step, the arm's first, then the hand's learned parts.

::

    | arm joints [rad] | joint: hand joints [rad] | commanded: fingertips [m] | measured: fingertips [m] |
    |      n_arm       |          joints          |         3 fingers         |        3 fingers         |

Parts that are not learned are left out. All numbers are absolute. Relative to where the robot is, plans are
easier to predict, and worse to execute: in demonstrations the arm is already where the tool makes it go, so
the network need not look, and keeps every error it has made (de Haan et al. 2019, "Causal confusion in
imitation learning"; numbers in `eval/LOG.md`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from lerobot.utils.constants import ACTION
from torch import Tensor, nn

from lerobot_dexflex.conventions import COMMANDED, MEASURED
from lerobot_dexflex.evaluation.plan_parts import JOINT, PARTS
from lerobot_dexflex.hands import Hand
from lerobot_policy_dexflex.measured_tips import measured_tips
from lerobot_policy_dexflex.normalization import tip_numbers

MIN_ANGLE_STD = 0.001
"""A joint that hardly moves in the data is not blown up to unit scale [rad]."""
MIN_LENGTH_STD = 0.0002
"""The same for fingertips [m]."""
FITTED_BATCHES = 200
"""Training batches from which the scale of plans is estimated."""


class PlanLayout:
    """Which numbers a plan holds.

    Args:
        hand: The hand.
        n_arm: Joints of the arm.
        learns: Learned parts of the hand.
    """

    def __init__(self, hand: Hand, n_arm: int, learns: Sequence[str]) -> None:
        self._hand, self.n_arm = hand, n_arm
        self._slices: dict[str, slice] = {}
        self.size = n_arm
        for part in PARTS:
            if part in learns:
                begin = self.size
                self.size += hand.n_joints if part == JOINT else tip_numbers(hand)
                self._slices[part] = slice(begin, self.size)

    def targets(self, batch: Mapping[str, Any]) -> Tensor:
        """Return the demonstrated plans of a batch, absolute. Shape (batch, chunk, size).

        Reads nothing of what is not learned, which may be missing from demonstrations, or NaN.

        Args:
            batch: Holds `action` (batch, chunk, joints + tips); the measured fingertips if these are learned.

        Raises:
            DexFlexError: If the measured fingertips are missing.
        """
        action = batch[ACTION]
        n_joints = self.n_arm + self._hand.n_joints
        parts = {
            JOINT: lambda: action[..., self.n_arm : n_joints],
            COMMANDED: lambda: action[..., n_joints:],
            MEASURED: lambda: measured_tips(batch),
        }
        return torch.cat([action[..., : self.n_arm], *(parts[part]() for part in self._slices)], -1)

    def columns(self, part: str) -> list[int]:
        """Return the columns of what an interface executes: the arm and one part of the hand."""
        hand = self._slices[part]
        return [*range(self.n_arm), *range(hand.start, hand.stop)]

    def angles(self) -> Tensor:
        """Tell which numbers are angles, the others being lengths. Shape (size,), bool."""
        angles = torch.zeros(self.size, dtype=torch.bool)
        angles[: self.n_arm] = True
        angles[self._slices.get(JOINT, slice(0))] = True
        return angles

    def weights(self) -> Tensor:
        """Return the share of every number in the loss; they add up to 1. Shape (size,).

        The arm has half of it; the learned parts of the hand share the other half equally.
        """
        weights = torch.empty(self.size)
        hand = 0.5 if self.n_arm else 1.0
        weights[: self.n_arm] = 0.5 / max(self.n_arm, 1)
        for part in self._slices.values():
            weights[part] = hand / len(self._slices) / (part.stop - part.start)
        return weights


class PlanScale(nn.Module):
    """Bring plans to unit scale and back: every number of every step has its own mean and deviation.

    They are estimated from the first `FITTED_BATCHES` training batches and then stay.

    Args:
        chunk_size: Steps of a plan.
        layout: Its numbers.
    """

    mean: Tensor
    variance: Tensor
    counts: Tensor
    batches: Tensor
    smallest: Tensor

    def __init__(self, chunk_size: int, layout: PlanLayout) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(chunk_size, layout.size))
        self.register_buffer("variance", torch.zeros(chunk_size, layout.size))
        self.register_buffer("counts", torch.zeros(chunk_size, 1))
        self.register_buffer("batches", torch.zeros((), dtype=torch.int64))
        smallest = torch.where(layout.angles(), MIN_ANGLE_STD, MIN_LENGTH_STD)
        self.register_buffer("smallest", smallest, persistent=False)

    @property
    def std(self) -> Tensor:
        """Standard deviations. Shape (chunk, size)."""
        return torch.maximum(self.variance.sqrt(), self.smallest)

    def begin(self) -> None:
        """Forget what was seen, for a new training: its first batch replaces mean and variance."""
        self.counts.zero_()
        self.batches.zero_()

    @torch.no_grad()
    def observe(self, plans: Tensor, valid: Tensor) -> None:
        """Take a training batch into account, if it is one of the first.

        Args:
            plans: Shape (batch, chunk, size).
            valid: Steps within the demonstration. Shape (batch, chunk), bool.
        """
        if self.batches >= FITTED_BATCHES:
            return
        self.batches += 1
        kept = valid[..., None]  # (batch, chunk, 1)
        new = kept.sum(0).to(plans.dtype)  # (chunk, 1)
        counts = self.counts + new
        mean = torch.where(kept, plans, 0).sum(0) / new.clamp(min=1)
        variance = torch.where(kept, (plans - mean).square(), 0).sum(0) / new.clamp(min=1)
        # Two sets together (Chan et al. 1979); a step that was never valid keeps what it has.
        share = torch.where(counts > 0, new / counts.clamp(min=1), 0)
        difference = mean - self.mean
        self.variance.lerp_(variance, share).add_(share * (1 - share) * difference.square())
        self.mean.add_(share * difference)
        self.counts.copy_(counts)

    def forward(self, plans: Tensor) -> Tensor:
        """Normalise plans (..., chunk, size)."""
        return (plans - self.mean) / self.std

    def inverse(self, plans: Tensor) -> Tensor:
        """Undo `forward`."""
        return plans * self.std + self.mean
