"""What happened in the episodes that failed: how they ended, and how far they had come."""

from collections.abc import Sequence

import pandas as pd

from lerobot_dexflex.evaluation.outcome import ending_of


def endings(rows: pd.DataFrame) -> list[str]:
    """Return how every episode ended; see `ending_of`."""
    return [ending_of(bool(ok), drops) for ok, drops in zip(rows["success"], rows["drops"], strict=True)]


def failures(rows: pd.DataFrame, stages: Sequence[str]) -> list[str]:
    """Return in which way each episode that failed did.

    Args:
        rows: Episodes of one task.
        stages: What progress 1/n, 2/n, ... 1 of the task stand for; without them the progress itself is told.
    """
    failed = rows.loc[~rows["success"].astype(bool)]
    return [
        f"{ending}, {_reached(progress, stages)}"
        for ending, progress in zip(endings(failed), failed["progress"], strict=True)
    ]


def _reached(progress: float, stages: Sequence[str]) -> str:
    if not stages:
        return f"progress {progress:.2f}"
    count = round(progress * len(stages))
    return f"after: {stages[count - 1]}" if count else f"never {stages[0]}"
