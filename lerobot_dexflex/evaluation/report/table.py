"""The Markdown tables of a comparison."""

from collections.abc import Sequence
from typing import Any

SIGNIFICANT = 0.05
"""Below this adjusted p-value a pair of interfaces is named in a sentence."""
_MANY = 5
"""Of more interfaces, a sentence names only the pairs of the last one."""
RATE_HEADER = (
    "interface",
    "success",
    "95 % Wilson",
    "progress",
    "time to success [s]",
    "drops",
    "holding",
    "intervention",
)


def markdown(result: dict[str, Any]) -> str:
    """Return both tables, per interface and pairwise, with what they mean."""
    n = result["n_episodes"]
    first, last = result["seeds"]
    return "\n\n".join(
        [
            f"{n} paired episodes per interface, seeds {first} to {last}, {result['identity']['env']}",
            rates(result),
            pairs(result),
            *([failures(result)] if failure_rows(result) else []),
            "Progress is each episode's largest, drops per episode, holding the share of time with the "
            "object in hand, intervention the mean ||executed - draft|| / ||draft||; means with bootstrap "
            "95 % intervals. McNemar's exact test on paired episodes, p-values adjusted by Holm.",
        ]
    )


def rates(result: dict[str, Any]) -> str:
    """Return the table per interface."""
    return _table(RATE_HEADER, rate_rows(result))


def rate_rows(result: dict[str, Any]) -> list[list[str]]:
    """Return the cells of the table per interface."""
    rows = []
    for name, numbers in result["per_interface"].items():
        low, high = numbers["pc_success_ci95"]
        rows.append(
            [
                name,
                f"{numbers['n_success']}/{numbers['n_episodes']} ({numbers['pc_success']:.0f} %)",
                f"{low:.0f}-{high:.0f} %",
                _mean(numbers["progress_max"], 2),
                _mean(numbers["completion_time"], 1),
                _mean(numbers["drops"], 2),
                _mean(numbers["holding"], 2),
                _mean(numbers["intervention"], 2),
            ]
        )
    return rows


PAIR_HEADER = ("pair", "only first", "only second", "McNemar p", "p (Holm)", "progress, second - first")


def pairs(result: dict[str, Any]) -> str:
    """Return the table of paired tests; empty for a single interface."""
    rows = pair_rows(result)
    return _table(PAIR_HEADER, rows) if rows else "One interface: nothing to compare."


def pair_rows(result: dict[str, Any]) -> list[list[str]]:
    """Return the cells of the table of paired tests."""
    return [
        [
            f"{test['first']} vs {test['second']}",
            str(test["only_first"]),
            str(test["only_second"]),
            f"{test['p_value']:.3g}",
            f"{test['p_value_holm']:.3g}",
            _mean(test["progress_gain"], 2, sign="+"),
        ]
        for test in result["pairwise"]
    ]


def failure_header(result: dict[str, Any]) -> tuple[str, ...]:
    """Return the header of the table of failures."""
    return ("failure", *result["per_interface"])


def failure_rows(result: dict[str, Any]) -> list[list[str]]:
    """Return how many episodes of every interface failed in each way; no rows if none failed."""
    counts = [numbers["failures"] for numbers in result["per_interface"].values()]
    kinds = sorted(
        {kind for count in counts for kind in count}, key=lambda k: -sum(c.get(k, 0) for c in counts)
    )
    return [[kind, *(str(count.get(kind, 0)) for count in counts)] for kind in kinds]


def failures(result: dict[str, Any]) -> str:
    """Return the table of failures."""
    return _table(failure_header(result), failure_rows(result))


def across_markdown(found: dict[str, Any]) -> str:
    """Return success by interface and task, and the paired tests over all episodes.

    Of more than five interfaces, only the last one's tests are told; Holm's adjustment is over all pairs.

    Args:
        found: From `evaluation.across.across`.
    """
    last = [*found["success"]][-1]
    few = len(found["success"]) <= _MANY
    tests = [test for test in found["pairwise"] if few or last in (test["first"], test["second"])]
    rows = [
        [f"`{name}`", *(_rate(row[c]) for c in found["columns"])] for name, row in found["success"].items()
    ]
    return (
        _table(("interface", *found["columns"]), rows)
        + f"\n\nSuccess with Wilson 95 % intervals; {found['n_episodes']} paired episodes per cell. Exact "
        + f"McNemar tests over all episodes (Holm): {paired_sentence(tests)}."
    )


def paired_sentence(pairwise: Sequence[dict[str, Any]]) -> str:
    """Return which pairs differ, and the smallest p-value of those that do not.

    Args:
        pairwise: Paired tests with `first`, `second` and `p_value_holm`.
    """
    named = [t for t in pairwise if t["p_value_holm"] < SIGNIFICANT]
    parts = [f"{t['first']} against {t['second']} p = {t['p_value_holm']:.2g}" for t in named]
    rest = [t["p_value_holm"] for t in pairwise if t["p_value_holm"] >= SIGNIFICANT]
    if rest:
        which = "all other pairs" if named else "all pairs"
        parts.append(f"{which} p {'=' if min(rest) == 1 else '≥'} {min(rest):.2g}")
    return ", ".join(parts)


def _rate(rate: dict[str, Any]) -> str:
    low, high = rate["pc_success_ci95"]
    return f"{rate['pc_success']:.0f} % [{low:.0f}, {high:.0f}]"


def _mean(metric: dict[str, Any] | None, digits: int, sign: str = "") -> str:
    if metric is None:
        return "-"
    text = f"{metric['mean']:{sign}.{digits}f}"
    if metric["ci95"] is None:
        return text
    low, high = (f"{bound:{sign}.{digits}f}" for bound in metric["ci95"])
    return f"{text} [{low}, {high}]"


def _table(header: tuple[str, ...], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
