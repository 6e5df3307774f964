"""The tables and the page of a benchmark, from its rows."""

import html
from collections.abc import Iterable
from pathlib import Path

from lerobot_dexflex.evaluation.reach import plots, tables
from lerobot_dexflex.evaluation.reach.benchmark import Benchmark
from lerobot_dexflex.evaluation.reach.films import choose_episode, show_episode
from lerobot_dexflex.evaluation.reach.summary import Summary
from lerobot_dexflex.evaluation.report.html_parts import document, picture, table, video, write_page
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
    removals = [name for name in benchmark.conditions if name.startswith("removal")]
    header = tables.metric_header(summary)
    sections = [
        "<h1>Degraded commands: who recovers the intent?</h1>",
        f"<p>{html.escape(tables.about(summary))}</p>",
        picture(
            plots.bars(summary),
            "Duration, progress and intent error per condition, bootstrap 95 % intervals.",
        ),
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
    return write_page(benchmark.output / PAGE, document("Degraded commands", sections))


def _pictures(summary: Summary) -> Iterable[str]:
    if drawn := plots.around_removals(summary):
        yield "<h2>Selective intervention</h2>"
        yield picture(drawn, "Mean intervention around removals with 95 % intervals; low outside is the aim.")
    if drawn := plots.gains(summary):
        yield "<h2>Is it more than damping?</h2>"
        yield picture(drawn, "Progress over the output gain: what shrinking alone achieves.")
    if drawn := plots.ablations(summary):
        yield "<h2>Ablations</h2>"
        yield picture(drawn, "Progress without one part at a time; as many candidates each.")


def _episode(benchmark: Benchmark, summary: Summary, condition: str) -> Iterable[str]:
    seed = choose_episode(summary.rows, condition, summary.reference)
    if seed is None or summary.reference == "raw":
        return
    chains = benchmark.book(condition).load(benchmark.episodes)
    chain = next(chain for chain in chains if chain.seed == seed)
    methods = ("raw", summary.reference)
    shown = show_episode(chain, condition, methods, benchmark.output, benchmark.controller)
    yield "<h2>One episode</h2>"
    yield video(
        shown.film,
        f"Seed {seed} under {condition}: the first episode that raw drops and {summary.reference} does not, "
        "so a selection; run again alone, twice real time.",
    )
    yield picture(plots.interventions(shown.episodes), "The same episode: what was changed, and when.")


def _more_tables(summary: Summary, header: list[str]) -> Iterable[str]:
    for metric, title in tables.TITLES.items():
        if metric != "progress":
            yield f"<h2>{html.escape(title)}</h2>"
            yield table(header, tables.metric_rows(summary, metric))
    yield "<h2>Dropped episodes</h2>"
    yield table(tables.drop_header(summary), tables.drop_rows(summary))
    if rows := tables.split_rows(summary):
        yield "<h2>In and outside removals</h2>"
        yield table(tables.SPLIT_HEADER, rows)
    if rows := tables.branch_rows(summary):
        yield "<h2>Chosen candidates</h2>"
        yield table(tables.BRANCH_HEADER, rows)


def _origins(benchmark: Benchmark, summary: Summary) -> list[list[str]]:
    """Return where each version's rows come from."""
    shown = set(summary.rows["version"].dropna())
    origins = Table(benchmark.table).origins().to_dict("records")
    return [[str(row[name]) for name in _ORIGIN] for row in origins if row["version"] in shown]
