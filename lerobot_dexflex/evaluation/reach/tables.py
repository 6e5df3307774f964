"""The tables of a benchmark, as rows of text."""

from collections.abc import Sequence

import numpy as np

from lerobot_dexflex.evaluation.reach.episodes import BRANCHES
from lerobot_dexflex.evaluation.reach.summary import PAPER_FAMILIES, Summary
from lerobot_dexflex.runs.statistics import Mean, success_rate

Rows = list[list[str]]
TITLES = {
    "progress": "Task progress (goals reached, with partial credit)",
    "progress_budget": "Task progress within 1.25 times the operator's own time",
    "goal_steps": "Control steps per goal reached",
    "duration": "Duration until the object is dropped, as a share of the time limit",
    "intent": "Intent error: selected against clean motion, 1 after a drop",
    "intent_loaded": "Intent error of the fingers that carry load",
    "intent_free": "Intent error of the fingers that carry none",
    "intervention": "Intervention: selected motion against the draft",
    "retention": "Contact retention: loaded fingers that still carry load 8 steps later",
}
SPLIT_HEADER = (
    "method",
    "condition",
    "intent error in / outside events",
    "intervention in / outside events",
)
TEST_HEADER = ("condition", "against", "gain in progress", "p (Wilcoxon)", "p (Holm)", "episodes")
BRANCH_HEADER = ("method", "condition", *BRANCHES)


def metric_header(summary: Summary) -> list[str]:
    """Return the header of `metric_rows`."""
    return ["method", *summary.conditions]


def metric_rows(summary: Summary, metric: str) -> Rows:
    """Return one row per method: a metric under every condition, with intervals."""
    return [
        [method, *(mean_text(summary.mean(method, condition, metric)) for condition in summary.conditions)]
        for method in summary.methods
    ]


def drop_header(summary: Summary) -> list[str]:
    """Return the header of `drop_rows`."""
    return ["method", *summary.run]


def drop_rows(summary: Summary) -> Rows:
    """Return one row per method with dropped episodes under every condition and Wilson intervals."""

    def text(method: str, condition: str) -> str:
        rate = success_rate(summary.of(method, condition)["dropped"].astype(bool).tolist())
        low, high = rate.pc_success_ci95
        return f"{rate.n_success}/{rate.n_episodes} ({low:.0f}-{high:.0f} %)"

    return [[method, *(text(method, condition) for condition in summary.run)] for method in summary.methods]


def split_rows(summary: Summary) -> Rows:
    """Return errors and interventions inside and outside of events, where there are any."""
    return [
        [
            method,
            condition,
            *(
                _pair(*(summary.mean(method, condition, f"{metric}_{when}") for when in ("event", "calm")))
                for metric in ("intent", "intervention")
            ),
        ]
        for condition in summary.run
        for method in summary.methods
        if summary.of(method, condition)["intent_event"].notna().any()
    ]


def branch_rows(summary: Summary) -> Rows:
    """Return how often each kind of candidate was executed [%], for methods that choose."""
    shares = {
        (method, condition): [float(summary.of(method, condition)[branch].mean()) for branch in BRANCHES]
        for condition in summary.run
        for method in summary.methods
    }
    return [
        [*key, *(f"{100 * share:.0f} %" for share in values)]
        for key, values in shares.items()
        if np.isfinite(values).all()
    ]


def test_rows(summary: Summary) -> Rows:
    """Return the paired tests of the reference."""
    return [
        [
            test.condition,
            test.method,
            mean_text(test.gain, "+"),
            f"{test.p_value:.2g}",
            f"{test.p_value_holm:.2g}",
            str(test.n),
        ]
        for test in summary.tests
    ]


def markdown(summary: Summary) -> str:
    """Return all tables as Markdown."""
    header = metric_header(summary)
    parts = [about(summary)]
    for metric, title in TITLES.items():
        parts += [f"**{title}**", as_markdown(header, metric_rows(summary, metric))]
    parts += ["**Dropped episodes** (Wilson intervals)"]
    parts += [as_markdown(drop_header(summary), drop_rows(summary))]
    if split := split_rows(summary):
        parts += ["**In and outside events**", as_markdown(SPLIT_HEADER, split)]
    if chosen := branch_rows(summary):
        parts += ["**Chosen candidates**", as_markdown(BRANCH_HEADER, chosen)]
    if rows := test_rows(summary):
        parts += [f"**{summary.reference} against all others, paired**", as_markdown(TEST_HEADER, rows)]
    return "\n\n".join(parts)


def about(summary: Summary) -> str:
    """Return what the numbers are, in a few sentences."""
    seeds, averages = summary.rows["seed"], ", ".join(f"`{name}`" for name in summary.averages) or "none"
    return (
        f"{summary.rows.groupby(['method', 'condition']).size().max()} paired episodes per method and "
        f"condition (seeds {seeds.min()} to {seeds.max()}; of oracles fewer). Means with bootstrap 95 % "
        "intervals. Nobody has tried the goals, but for `verified` ones, which the operator reaches: what is "
        "missing to 1 may be the goal's fault, so compare with the bounds `operator`, which executes the "
        "operator's own joint targets, and `forces`, which follows the draft with the operator's forces. "
        "Drafts hold motion, but for `pressing` sources, which command into the object. Averages over "
        f"families: {averages}, each over {', '.join(PAPER_FAMILIES)} as far as they were run, each family "
        "counting the same. Tests: Wilcoxon's signed-rank on the progress of the same episodes, adjusted by "
        "Holm within each condition over the baselines and over the variants."
    )


def mean_text(mean: Mean | None, sign: str = "") -> str:
    """Return a mean with its interval."""
    if mean is None:
        return "-"
    if mean.ci95 is None:
        return f"{mean.mean:{sign}.2f}"
    low, high = (f"{bound:{sign}.2f}" for bound in mean.ci95)
    return f"{mean.mean:{sign}.2f} [{low}, {high}]"


def as_markdown(header: Sequence[str], rows: Rows) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _pair(inside: Mean | None, outside: Mean | None) -> str:
    return f"{mean_text(inside)} / {mean_text(outside)}"
