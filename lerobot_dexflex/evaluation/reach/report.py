"""The tables and the page of a benchmark, from its rows."""

import html
from collections.abc import Iterable
from pathlib import Path

from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.reach import plots, tables
from lerobot_dexflex.evaluation.reach.benchmark import Benchmark
from lerobot_dexflex.evaluation.reach.films import choose_episode, show_episode
from lerobot_dexflex.evaluation.reach.summary import Summary, family
from lerobot_dexflex.evaluation.report.html_parts import document, picture, table, video, write_page
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.table import Table

TABLES, PAGE = "degraded_commands.md", "report.html"
_ORIGIN = ("method", "version", "commit", "date", "settings", "command")


def write_report(benchmark: Benchmark, summary: Summary, films: bool = True) -> Path:
    """Write the tables and the page into the benchmark's folder and return the page's path.

    Args:
        benchmark: What was run.
        summary: Of its rows.
        films: Whether to run an episode again to film it.
    """
    (benchmark.output / TABLES).write_text(tables.markdown(summary) + "\n")
    first = plots.settings(summary)[0]
    removals = [n for n in summary.run if family(n) == "removal" and Condition.parse(n).setting == first]
    header = tables.metric_header(summary)
    sections = [
        "<h1>Degraded drafts: who keeps hold of the object and follows the intent?</h1>",
        f"<p>{html.escape(tables.about(summary))}</p>",
        *_bars(summary),
        "<h2>Task progress</h2>",
        table(header, tables.metric_rows(summary, "progress")),
        f"<h2>{html.escape(summary.reference)} against the others</h2>",
        table(tables.TEST_HEADER, tables.test_rows(summary)),
        *_pictures(summary),
        *(_episode(benchmark, summary, removals[-1]) if films and removals else ()),
        *_more_tables(summary, header),
        "<h2>Provenance</h2>",
        table(_ORIGIN, _origins(benchmark, summary)),
    ]
    return write_page(benchmark.output / PAGE, document("Degraded drafts", sections))


def _bars(summary: Summary) -> Iterable[str]:
    for setting in plots.settings(summary):
        words = ", ".join(setting) or "drafts of motion, goals that nobody tried"
        yield picture(
            plots.bars(summary, setting),
            f"Progress (in the full time and in the tight one), duration and intent error: {words}; "
            "bootstrap 95 % intervals.",
        )


def _pictures(summary: Summary) -> Iterable[str]:
    if drawn := plots.around_removals(summary):
        yield "<h2>Selective intervention</h2>"
        yield picture(drawn, "Mean intervention around removals with 95 % intervals; low outside is the aim.")
    if drawn := plots.gains(summary):
        yield "<h2>Is it more than damping?</h2>"
        yield picture(drawn, "Progress over the gain of the motion: what shrinking alone achieves.")
    if drawn := plots.ablations(summary):
        yield "<h2>Ablations</h2>"
        yield picture(drawn, "Progress without one part at a time; as many candidates each.")


def _episode(benchmark: Benchmark, summary: Summary, condition: str) -> Iterable[str]:
    rival = _rival(summary)
    seed = choose_episode(summary.rows, condition, rival, summary.reference) if rival else None
    if rival is None or seed is None:
        return
    chains = benchmark.book(condition).load(benchmark.episodes)
    chain = next(chain for chain in chains if chain.seed == seed)
    methods = (rival, summary.reference)
    shown = show_episode(
        get_hand(benchmark.hand), chain, condition, methods, benchmark.output, benchmark.controller
    )
    yield "<h2>One episode</h2>"
    yield video(
        shown.film,
        f"Seed {seed} under {condition}: the first episode that {rival} drops and {summary.reference} does "
        "not, so a selection; run again alone, twice real time.",
    )
    yield picture(plots.episode(shown.episodes), "The same episode: what was changed, and when.")


def _rival(summary: Summary) -> str | None:
    """Return whom the reference is filmed beside: the first grip written by hand, else raw, if they ran."""
    others = [name for name in summary.methods if name != summary.reference]
    bases = {Method.parse(name).base: name for name in reversed(others)}
    return bases.get("press") or bases.get("raw")


def _more_tables(summary: Summary, header: list[str]) -> Iterable[str]:
    for metric, title in tables.TITLES.items():
        if metric != "progress":
            yield f"<h2>{html.escape(title)}</h2>"
            yield table(header, tables.metric_rows(summary, metric))
    yield "<h2>Dropped episodes</h2>"
    yield table(tables.drop_header(summary), tables.drop_rows(summary))
    if rows := tables.split_rows(summary):
        yield "<h2>In and outside events</h2>"
        yield table(tables.SPLIT_HEADER, rows)
    if rows := tables.branch_rows(summary):
        yield "<h2>Chosen candidates</h2>"
        yield table(tables.BRANCH_HEADER, rows)


def _origins(benchmark: Benchmark, summary: Summary) -> list[list[str]]:
    """Return where each version's rows come from."""
    shown = set(summary.rows["version"].dropna())
    origins = Table(benchmark.table).origins().to_dict("records")
    return [[str(row[name]) for name in _ORIGIN] for row in origins if row["version"] in shown]
