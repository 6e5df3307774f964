"""What happened in the episodes that failed: how they ended, and how far they had come."""

from collections import Counter
from collections.abc import Sequence

from lerobot_dexflex.evaluation.outcome import Outcome


def count_failures(outcomes: Sequence[Outcome], stages: Sequence[str]) -> dict[str, int]:
    """Return how many episodes failed in each way, the most frequent first.

    Args:
        outcomes: Episodes of one interface.
        stages: What progress 1/n, 2/n, ... 1 of the task stand for; without them the progress itself is told.
    """
    failed = Counter(f"{o.ending}, {_reached(o, stages)}" for o in outcomes if not o.success)
    return dict(sorted(failed.items(), key=lambda item: (-item[1], item[0])))


def _reached(outcome: Outcome, stages: Sequence[str]) -> str:
    if not stages:
        return f"progress {outcome.progress_max:.2f}"
    count = round(outcome.progress_max * len(stages))
    return f"after: {stages[count - 1]}" if count else f"never {stages[0]}"
