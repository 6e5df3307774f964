"""From episodes to the numbers of the result file."""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.failures import count_failures
from lerobot_dexflex.evaluation.outcome import Outcome
from lerobot_dexflex.runs.statistics import holm, mean_interval, paired_test, success_rate

_METRICS: dict[str, Callable[[Outcome], float | None]] = {
    "progress_max": lambda o: o.progress_max,
    "progress_final": lambda o: o.progress_final,
    "completion_time": lambda o: o.completion_time,
    "steps": lambda o: o.steps,
    "drops": lambda o: o.drops,
    "holding": lambda o: o.holding,
    "intervention": lambda o: o.intervention,
}
"""Continuous metrics per episode; None where undefined (completion time without success, ...)."""


def by_interface(outcomes: Sequence[Outcome], interfaces: Sequence[str]) -> dict[str, list[Outcome]]:
    """Sort episodes by interface and index, and check that they are paired.

    Raises:
        DexFlexError: If the interfaces did not run the same episodes with the same seeds.
    """
    sorted_outcomes = {
        name: sorted((o for o in outcomes if o.interface == name), key=lambda o: o.episode)
        for name in interfaces
    }
    runs = {name: [(o.episode, o.seed) for o in found] for name, found in sorted_outcomes.items()}
    if len({tuple(run) for run in runs.values()}) > 1:
        counts = {name: len(run) for name, run in runs.items()}
        raise DexFlexError(f"The interfaces did not run the same episodes, so nothing is paired: {counts}.")
    return sorted_outcomes


def summarise(
    outcomes: Sequence[Outcome], interfaces: Sequence[str], stages: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the summary per interface and the paired tests, as plain values.

    Args:
        outcomes: Episodes of all interfaces.
        interfaces: Their names.
        stages: Of the task; see `count_failures`.
    """
    found = by_interface(outcomes, interfaces)
    pairs = list(combinations(interfaces, 2))
    tests = [_compare(found[a], found[b]) for a, b in pairs]
    adjusted = holm([test["p_value"] for test in tests])
    return {
        "per_interface": {name: _describe(found[name], stages) for name in interfaces},
        "pairwise": [
            {"first": a, "second": b, **test, "p_value_holm": p}
            for (a, b), test, p in zip(pairs, tests, adjusted, strict=True)
        ],
    }


def _describe(outcomes: Sequence[Outcome], stages: Sequence[str]) -> dict[str, Any]:
    metrics = {}
    for name, metric in _METRICS.items():
        mean = mean_interval([value for o in outcomes if (value := metric(o)) is not None])
        metrics[name] = None if mean is None else mean._asdict()
    endings = [o.ending for o in outcomes]
    counts = {ending: endings.count(ending) for ending in ("success", "dropped", "time out")}
    failures = {"endings": counts, "failures": count_failures(outcomes, stages)}
    return success_rate([o.success for o in outcomes])._asdict() | failures | metrics


def _compare(first: Sequence[Outcome], second: Sequence[Outcome]) -> dict[str, Any]:
    test = paired_test([o.success for o in first], [o.success for o in second])
    gain = mean_interval([b.progress_max - a.progress_max for a, b in zip(first, second, strict=True)])
    return test._asdict() | {"progress_gain": None if gain is None else gain._asdict()}
