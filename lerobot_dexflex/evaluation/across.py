"""Several comparisons of the same interfaces, one per task or condition, and their average."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.statistics import holm, mean_interval, paired_test, success_rate

AVERAGE = "average"


def across(results: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return success by interface and task, over all tasks together, and paired tests over all episodes.

    Every task has the same number of episodes, so that the rate over all of them is the tasks' average.

    Args:
        results: Contents of `comparison.json` files, by the name of their column.

    Raises:
        DexFlexError: If they do not compare the same interfaces on equally many episodes.
    """
    if not results:
        raise DexFlexError("Nothing to average: give one or more comparison.json files.")
    interfaces = _interfaces(results)
    count = _alike(results, "episodes per interface", lambda result: result["n_episodes"])
    outcomes = {
        name: {task: _values(result, name, "success") for task, result in results.items()}
        for name in interfaces
    }
    progress = {
        name: [value for result in results.values() for value in _values(result, name, "progress_max")]
        for name in interfaces
    }
    every = {name: [value for task in results for value in outcomes[name][task]] for name in interfaces}
    pairs = list(combinations(interfaces, 2))
    tests = [paired_test(every[a], every[b])._asdict() for a, b in pairs]
    adjusted = holm([test["p_value"] for test in tests])
    return {
        "columns": [*results, AVERAGE],
        "n_episodes": count,
        "sources": {task: result["config_hash"] for task, result in results.items()},
        "success": {
            name: {task: success_rate(values)._asdict() for task, values in outcomes[name].items()}
            | {AVERAGE: success_rate(every[name])._asdict()}
            for name in interfaces
        },
        "progress": {name: _plain(progress[name]) for name in interfaces},
        "pairwise": [
            {"first": a, "second": b, **test, "p_value_holm": p}
            for (a, b), test, p in zip(pairs, tests, adjusted, strict=True)
        ],
    }


def pool(results: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return comparisons of the same interfaces as one for `across`, their episodes one after the other.

    Raises:
        DexFlexError: If they do not compare the same interfaces.
    """
    interfaces = _interfaces(results)
    rows, count = [], 0
    for result in results.values():
        rows += [row | {"episode": count + row["episode"]} for row in result["episodes"]]
        count += result["n_episodes"]
    return {
        "config_hash": "+".join(result["config_hash"] for result in results.values()),
        "n_episodes": count,
        "per_interface": dict.fromkeys(interfaces),
        "episodes": rows,
    }


def _interfaces(results: Mapping[str, dict[str, Any]]) -> tuple[str, ...]:
    return _alike(results, "interfaces", lambda result: tuple(result["per_interface"]))


def _alike(results: Mapping[str, dict[str, Any]], what: str, read: Any) -> Any:
    found = {task: read(result) for task, result in results.items()}
    if len(set(found.values())) > 1:
        raise DexFlexError(f"The comparisons differ in {what}, so there is no fair average: {found}.")
    return next(iter(found.values()))


def _values(result: dict[str, Any], interface: str, key: str) -> list[Any]:
    """Return a value of each episode of an interface, in the order of the episodes."""
    rows = [row for row in result["episodes"] if row["interface"] == interface]
    return [row[key] for row in sorted(rows, key=lambda row: row["episode"])]


def _plain(values: Sequence[float]) -> dict[str, Any] | None:
    mean = mean_interval(values)
    return None if mean is None else mean._asdict()
