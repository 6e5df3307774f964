"""The tables of a benchmark, as rows of text."""

from collections.abc import Callable, Sequence
from typing import Any

from lerobot_dexflex.evaluation.reach.summary import FAMILIES

Rows = list[list[str]]
TITLES = {
    "progress": "Task progress (goals reached, with partial credit)",
    "duration": "Duration until the object is dropped, as a share of the time limit",
    "intent": "Intent error against the clean command, 1 after a drop",
    "retention": "Contact retention: loaded fingers that still carry load 8 steps later",
    "intervention": "Intervention: size of the change to the draft",
}
SPLIT_HEADER = ("method", "cell", "intent error in / outside removals", "intervention in / outside removals")
TEST_HEADER = ("cell", "against", "gain in progress", "p (Wilcoxon)", "p (Holm)", "episodes")


def metric_header(result: dict[str, Any]) -> list[str]:
    """Return the header of `metric_rows`."""
    return ["method", *(["families"] if result[FAMILIES] else []), *result["cells"]]


def metric_rows(result: dict[str, Any], metric: str) -> Rows:
    """Return one row per method: the average over families, then every cell, with intervals."""
    return _rows(result, lambda numbers: _mean(numbers[metric]))


def drop_rows(result: dict[str, Any]) -> Rows:
    """Return one row per method with dropped episodes per cell and Wilson intervals."""

    def text(numbers: dict[str, Any]) -> str:
        if "drops" not in numbers:
            return ""
        low, high = (100 - bound for bound in reversed(numbers["pc_kept_ci95"]))
        return f"{numbers['drops']}/{numbers['n']} ({low:.0f}-{high:.0f} %)"

    return _rows(result, text)


def split_rows(result: dict[str, Any]) -> Rows:
    """Return errors and interventions inside and outside of removals, where there are any."""
    return [
        [
            method,
            cell,
            *(_pair(numbers[f"{m}_event"], numbers[f"{m}_calm"]) for m in ("intent", "intervention")),
        ]
        for cell, methods in result["cells"].items()
        for method, numbers in methods.items()
        if numbers["intent_event"]
    ]


def test_rows(result: dict[str, Any], cells: Sequence[str]) -> Rows:
    """Return the paired tests of the reference in these cells."""
    return [
        [
            test["cell"],
            test["method"],
            _mean(test["gain"], "+"),
            f"{test['p_value']:.2g}",
            f"{test['p_value_holm']:.2g}",
            str(test["n"]),
        ]
        for test in result["tests"]
        if test["cell"] in cells
    ]


def markdown(result: dict[str, Any]) -> str:
    """Return all tables as Markdown."""
    header = metric_header(result)
    parts = [about(result)]
    for metric, title in TITLES.items():
        parts += [f"**{title}**", as_markdown(header, metric_rows(result, metric))]
    parts += ["**Dropped episodes** (Wilson intervals)", as_markdown(header, drop_rows(result))]
    if split := split_rows(result):
        parts += ["**In and outside removals**", as_markdown(SPLIT_HEADER, split)]
    if rows := test_rows(result, [*result["cells"], FAMILIES]):
        parts += [f"**{result['reference']} against all others, paired**", as_markdown(TEST_HEADER, rows)]
    return "\n\n".join(parts)


def about(result: dict[str, Any]) -> str:
    """Return what the numbers are, in a few sentences."""
    kind = "tuning" if result["tuning"] else "test"
    averaged = ", ".join(result["averaged_cells"]) or "none"
    return (
        f"{result['n_episodes']} paired episodes per method and cell on {kind} objects (seeds from "
        f"{result['first_seed']}; of oracles fewer). Means with bootstrap 95 % intervals. "
        f"Goals were verified with clean commands: clean raw is near 1 by selection. The average over "
        f"families is over {averaged}, each family counting the same. Tests: Wilcoxon's signed-rank on the "
        "progress of the same episodes, adjusted by Holm within each cell over the baselines and over the "
        "variants."
    )


def _rows(result: dict[str, Any], text: Callable[[dict[str, Any]], str]) -> Rows:
    families = result[FAMILIES]
    rows = []
    for method in result["methods"]:
        row = [method]
        if families:
            row.append(text(families[method]))
        rows.append(row + [text(methods[method]) for methods in result["cells"].values()])
    return rows


def _pair(inside: dict[str, Any] | None, outside: dict[str, Any] | None) -> str:
    return f"{_mean(inside)} / {_mean(outside)}"


def _mean(metric: dict[str, Any] | None, sign: str = "") -> str:
    if metric is None:
        return "-"
    if metric["ci95"] is None:
        return f"{metric['mean']:{sign}.2f}"
    low, high = (f"{bound:{sign}.2f}" for bound in metric["ci95"])
    return f"{metric['mean']:{sign}.2f} [{low}, {high}]"


def as_markdown(header: Sequence[str], rows: Rows) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
