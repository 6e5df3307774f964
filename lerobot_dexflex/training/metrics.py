"""Held-out numbers that several stages report."""

import torch
from scipy.stats import rankdata
from torch import Tensor


def roc_auc(score: Tensor, positive: Tensor) -> float:
    """Return the area under the ROC curve by ranks; NaN if one class is absent.

    Args:
        score: Higher means more likely positive. Shape (n,).
        positive: Shape (n,), bool.
    """
    n_positive = int(positive.sum())
    n_negative = len(positive) - n_positive
    if not n_positive or not n_negative:
        return float("nan")
    ranks = torch.from_numpy(rankdata(score.numpy()))
    return float((ranks[positive].sum() - n_positive * (n_positive + 1) / 2) / (n_positive * n_negative))


def choose(rows: Tensor, count: int, seed: int = 0) -> Tensor:
    """Return at most so many of the rows, the same on every call, in order."""
    generator = torch.Generator().manual_seed(seed)
    return rows[torch.randperm(len(rows), generator=generator)[:count]].sort().values


def draw(rows: Tensor, count: int) -> Tensor:
    """Return rows drawn with replacement from torch's global generator."""
    return rows[torch.randint(len(rows), (count,))]
