"""The chunk that a hand is executing, row by row."""

from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.interfaces.explanation import Choice


class Plan(NamedTuple):
    """A chosen chunk, how much of it is done, and why it was chosen."""

    targets: Tensor
    """Where the fingertips should be, palm frame [m]. Shape (batch, horizon, fingers, 3)."""
    choice: Choice
    age: Tensor
    """Steps that were executed. Shape (batch,)."""

    def motion(self, tips: Tensor) -> Tensor:
        """Return what is left of the plan from where the tips are, its last step held.

        Args:
            tips: Measured fingertips [m]. Shape (batch, fingers, 3).
        """
        steps = torch.arange(self.targets.shape[1], device=tips.device)
        ahead = (self.age[:, None] + steps).clamp(max=len(steps) - 1)
        rows = torch.arange(len(tips), device=tips.device)[:, None]
        return self.targets[rows, ahead] - tips[:, None]

    def older(self) -> "Plan":
        """Return the plan after one more step."""
        return self._replace(age=self.age + 1)

    def expired(self, rows: Tensor, age: int) -> "Plan":
        """Return the plan with the age of some rows, a mask (batch,), set."""
        return self._replace(age=self.age.masked_fill(rows, age))

    def renewed(self, rows: Tensor, new: "Plan") -> "Plan":
        """Return the plan with some rows, a mask (batch,), taken from another."""
        choice = Choice(*(_where(rows, a, b) for a, b in zip(new.choice, self.choice, strict=True)))
        return Plan(_where(rows, new.targets, self.targets), choice, _where(rows, new.age, self.age))


def _where(rows: Tensor, new: Tensor, old: Tensor) -> Tensor:
    return torch.where(rows.view(-1, *[1] * (new.ndim - 1)), new, old)
