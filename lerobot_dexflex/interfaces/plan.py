"""The chunk that a hand is executing, row by row."""

from typing import NamedTuple

import torch
from torch import Tensor

from lerobot_dexflex.interfaces.explanation import Choice


class Plan(NamedTuple):
    """A chosen chunk, how much of it is done, and why it was chosen."""

    chunk: Tensor
    """Displacements of the commanded fingertips [m]. Shape (batch, horizon, 4, 3)."""
    residual: Tensor
    """Correction of the joint targets [rad]. Shape (batch, 16)."""
    choice: Choice
    age: Tensor
    """Displacements that were executed. Shape (batch,)."""

    def displacement(self) -> Tensor:
        """Return the next displacements [m]. Shape (batch, 4, 3)."""
        return self.chunk[torch.arange(len(self.age), device=self.age.device), self.age]

    def older(self) -> "Plan":
        """Return the plan after one more displacement."""
        return self._replace(age=self.age + 1)

    def expired(self, rows: Tensor, age: int) -> "Plan":
        """Return the plan with the age of some rows, a mask (batch,), set."""
        return self._replace(age=self.age.masked_fill(rows, age))

    def renewed(self, rows: Tensor, new: "Plan") -> "Plan":
        """Return the plan with some rows, a mask (batch,), taken from another."""
        choice = Choice(*(_where(rows, a, b) for a, b in zip(new.choice, self.choice, strict=True)))
        chunk, residual = _where(rows, new.chunk, self.chunk), _where(rows, new.residual, self.residual)
        return Plan(chunk, residual, choice, _where(rows, new.age, self.age))


def _where(rows: Tensor, new: Tensor, old: Tensor) -> Tensor:
    return torch.where(rows.view(-1, *[1] * (new.ndim - 1)), new, old)
