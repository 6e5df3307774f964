"""The tables of a comparison, as cells of text and as Markdown."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from lerobot_dexflex.evaluation.failures import failures
from lerobot_dexflex.evaluation.summary import PairTest, Summary
from lerobot_dexflex.runs.statistics import SIGNIFICANT, Mean, Rate

_MANY = 5
"""Of more methods, a sentence names only the pairs of the last one."""
DETAIL_HEADER = (
    "method",
    "success",
    "95 % Wilson",
    "letters",
    "progress",
    "time to success [s]",
    "of all [s]",
    "drops",
    "holding",
    "NHT",
    "intervention",
)
_METRICS = ("progress", "completion_time", "limited_time", "drops", "holding", "nht", "intervention")
_PAIR_HEADER = ("pair", "episodes", "only first", "only second", "McNemar p", "p (Holm)", "progress gain")
SELECTIVITY_HEADER = (
    "method",
    "change at contacts [mm]",
    "in calm [mm]",
    "ratio",
    "intervention at contacts",
    "in calm",
)
_GROWN_HEADER = ("E", "1/E (Holm)")
MEANINGS = (
    "Success with Wilson 95 % intervals. Methods that share a letter do not differ significantly (5 %, after "
    "Holm). Progress is each episode's largest, the time of all counts failures by the time limit, drops are "
    "per episode, holding is the share of time with the object in hand, NHT that of the time from the first "
    "grasp to success or time limit, intervention the mean ||selected - draft|| / ||draft||; means with "
    "bootstrap 95 % intervals. McNemar's exact test on paired episodes, p-values adjusted by Holm over "
    "all pairs of the table; progress gain: second - first. E, where episodes come from more than one "
    "command: its inverse is a p-value also if some were added after a look."
)

Rows = list[list[str]]


def rate_header(summary: Summary) -> list[str]:
    """Return the header of `rate_rows`."""
    return ["method", *(column.removesuffix("-v0") for column in summary.columns)]


def rate_rows(summary: Summary) -> Rows:
    """Return success by method and column, with n where it differs between cells."""
    say = len(summary.counts) > 1
    return [
        [name, *(_rate(summary.rates.get((name, column)), say) for column in summary.columns)]
        for name in summary.methods
    ]


def detail_rows(summary: Summary) -> Rows:
    """Return everything that is known of each method, over all columns of the summary."""
    rows, letters = [], summary.letters
    for name in summary.methods:
        rate = summary.rates.get((name, summary.columns[-1]))
        found = ("-", "-") if rate is None else (_count(rate), _interval(rate))
        numbers = [
            mean_text(summary.mean(name, metric), 1 if metric.endswith("time") else 2) for metric in _METRICS
        ]
        rows.append([name, *found, letters.get(name, "-"), *numbers])
    return rows


def pair_header(summary: Summary) -> list[str]:
    """Return the header of `pair_rows`."""
    return [*_PAIR_HEADER, *(_GROWN_HEADER if _any_grew(summary) else ())]


def pair_rows(summary: Summary) -> Rows:
    """Return the paired tests; with E-values if episodes of any may have been added after a look."""
    return [
        [
            f"{test.first} vs {test.second}",
            str(test.n_episodes),
            str(test.only_first),
            str(test.only_second),
            f"{test.p_value:.3g}",
            f"{test.p_value_holm:.3g}",
            mean_text(summary.progress_gain(test), 2, sign="+"),
            *((_number(test.e_value), _number(test.p_anytime_holm)) if _any_grew(summary) else ()),
        ]
        for test in summary.tests
    ]


def selectivity_rows(summary: Summary) -> Rows:
    """Return how much the methods change drafts around contact events and in calm, of those that do."""
    rows = []
    for name in summary.methods:
        change = summary.ratio(name, "change_event", "change_calm")
        if change is None:
            continue
        metrics = ("change_event", "change_calm", "intervention_event", "intervention_calm")
        event, calm, *relative = (mean_text(summary.mean(name, metric), 2) for metric in metrics)
        rows.append([name, event, calm, mean_text(change, 1), *relative])
    return rows


def failure_header(summary: Summary) -> list[str]:
    """Return the header of `failure_rows`."""
    return ["failure", *summary.methods]


def failure_rows(summary: Summary, stages: Sequence[str]) -> Rows:
    """Return how many episodes of every method failed in each way, the most frequent first.

    Args:
        summary: Of one task.
        stages: See `evaluation.failures.failures`.
    """
    counts = [Counter(failures(summary.of(name), stages)) for name in summary.methods]
    total = sum(counts, Counter())
    kinds = sorted(total, key=lambda kind: (-total[kind], kind))
    return [[kind, *(str(count[kind]) for count in counts)] for kind in kinds]


def markdown(summary: Summary, title: str) -> str:
    """Return all tables of a condition, with a title."""
    pairs = as_markdown(pair_header(summary), pair_rows(summary)) if summary.tests else ""
    wide = as_markdown(rate_header(summary), rate_rows(summary)) if len(summary.columns) > 1 else ""
    detail = as_markdown(DETAIL_HEADER, detail_rows(summary))
    return "\n\n".join(part for part in (f"**{title}**: {about(summary)}", wide, detail, pairs) if part)


def details_markdown(summary: Summary, against: str = "") -> str:
    """Return everything that is known of each method over all columns, and the paired tests.

    Args:
        summary: What a table tells.
        against: Show only the tests against this method; all of them if empty.
    """
    parts = [_by_interface(DETAIL_HEADER, detail_rows(summary))]
    if shown := [test for test in summary.tests if test.concerns(against)]:
        parts.append(as_markdown(pair_header(summary), pair_rows(replace(summary, tests=tuple(shown)))))
    return "\n\n".join([*parts, f"{about(summary)} {MEANINGS}"])


def selectivity_markdown(summary: Summary) -> str:
    """Return how much the methods change drafts around contact events and in calm."""
    return (
        _by_interface(SELECTIVITY_HEADER, selectivity_rows(summary))
        + f"\n\n{about(summary)} At contacts: within a quarter of a second of a finger, or anything else, "
        "that touched the object or left it; in calm: all other steps with the object in hand. Change: mean "
        "||selected - draft|| of the fingertips; intervention: the same by ||draft||; means over episodes, "
        "bootstrap 95 % intervals; ratio: of the means."
    )


def about(summary: Summary) -> str:
    """Return how many episodes there are, and from which seeds."""
    seeds = summary.rows["seed"]
    return f"{_episodes(summary)} episodes per method and column, seeds {seeds.min()} to {seeds.max()}."


def rates_markdown(summary: Summary) -> str:
    """Return success by method and column, and the paired tests over all episodes in a sentence."""
    tests = (
        f" Exact McNemar tests over all episodes (Holm): {pairs_sentence(summary)}" if summary.tests else ""
    )
    return (
        _by_interface(rate_header(summary), rate_rows(summary))
        + f"\n\nSuccess with Wilson 95 % intervals; {_episodes(summary)} paired episodes per cell.{tests}"
    )


def detail_markdown(summary: Summary) -> str:
    """Return rates, intervals and times to success of one task, and the paired tests in a sentence."""
    header = ("interface", "success", "95 % interval (Wilson)", "time to success")
    rows = []
    for name in summary.methods:
        rate, seconds = summary.rates[name, summary.columns[-1]], summary.mean(name, "completion_time")
        low, high = rate.pc_success_ci95
        time = "-" if seconds is None else f"{seconds.mean:.1f} s"
        rows.append([f"`{name}`", _percent(rate), f"{low:.0f} to {high:.0f} %", time])
    seeds = summary.rows["seed"]
    tests = f" Exact McNemar tests (Holm): {pairs_sentence(summary)}" if summary.tests else ""
    return (
        as_markdown(header, rows)
        + f"\n\nn = {_episodes(summary)} paired episodes per interface, "
        + f"seeds {seeds.min()} to {seeds.max()}.{tests}"
    )


def pairs_sentence(summary: Summary) -> str:
    """Return which pairs differ, and the smallest p-value of those that do not.

    Of more than five methods, only the last one's tests are told; Holm's adjustment is over all pairs.
    """
    last, few = summary.methods[-1], len(summary.methods) <= _MANY
    tests = [test for test in summary.tests if few or test.concerns(last)]
    text = _differing([(test, test.p_value_holm) for test in tests]) + "."
    looked = [(test, p) for test in tests if (p := test.p_anytime_holm) is not None]
    if looked:
        text += (
            " These episodes come from more than one command; E-values, valid also if some were added after "
            f"a look (Holm): {_differing(looked)}."
        )
    return text


def as_markdown(header: Sequence[str], rows: Rows) -> str:
    """Return a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _by_interface(header: Sequence[str], rows: Rows) -> str:
    """Return a table of methods in Markdown as documents have it: they are interfaces, their names code."""
    return as_markdown(["interface", *header[1:]], [[f"`{name}`", *cells] for name, *cells in rows])


def mean_text(metric: Mean | None, digits: int, sign: str = "") -> str:
    """Return a mean and its interval; `-` if unknown."""
    if metric is None:
        return "-"
    text = f"{metric.mean:{sign}.{digits}f}"
    if metric.ci95 is None:
        return text
    low, high = (f"{bound:{sign}.{digits}f}" for bound in metric.ci95)
    return f"{text} [{low}, {high}]"


def summary_title(rows: pd.DataFrame) -> str:
    """Return the tasks and conditions of some episodes."""
    tasks, conditions = dict.fromkeys(rows["task"]), dict.fromkeys(rows["condition"])
    return f"{', '.join(tasks)}, {', '.join(conditions)}"


def _differing(tests: Sequence[tuple[PairTest, float]]) -> str:
    parts = [f"{test.first} against {test.second} p = {p:.2g}" for test, p in tests if p < SIGNIFICANT]
    rest = [p for _, p in tests if p >= SIGNIFICANT]
    if rest:
        which = "all other pairs" if parts else "all pairs"
        parts.append(f"{which} p {'=' if min(rest) == 1 else '≥'} {min(rest):.2g}")
    return ", ".join(parts)


def _any_grew(summary: Summary) -> bool:
    return any(test.e_value is not None for test in summary.tests)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _episodes(summary: Summary) -> str:
    return " to ".join(str(n) for n in dict.fromkeys((summary.counts[0], summary.counts[-1])))


def _percent(rate: Rate) -> str:
    return f"{rate.pc_success:.0f} % ({rate.n_success}/{rate.n_episodes})"


def _count(rate: Rate) -> str:
    return f"{rate.n_success}/{rate.n_episodes} ({rate.pc_success:.0f} %)"


def _interval(rate: Rate) -> str:
    low, high = rate.pc_success_ci95
    return f"{low:.0f}-{high:.0f} %"


def _rate(rate: Rate | None, with_count: bool) -> str:
    if rate is None:
        return "-"
    low, high = rate.pc_success_ci95
    count = f", n = {rate.n_episodes}" if with_count else ""
    return f"{rate.pc_success:.0f} % [{low:.0f}, {high:.0f}]{count}"
