"""The result file, its tables and the page of a benchmark."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from lerobot_dexflex.evaluation.provenance import identity_digest, session_provenance
from lerobot_dexflex.evaluation.reach import plots, tables
from lerobot_dexflex.evaluation.reach.cells import Cell
from lerobot_dexflex.evaluation.reach.films import choose_episode, film
from lerobot_dexflex.evaluation.reach.record import Record
from lerobot_dexflex.evaluation.reach.runner import Benchmark
from lerobot_dexflex.evaluation.reach.summary import FAMILIES, summarise
from lerobot_dexflex.evaluation.report.html_parts import (
    document,
    picture,
    provenance,
    table,
    video,
    write_page,
)
from lerobot_dexflex.evaluation.store import Store, write_json
from lerobot_dexflex.interfaces.method import Method

RESULT, TABLES, PAGE = "degraded_commands.json", "degraded_commands.md", "report.html"


def make_result(
    benchmark: Benchmark, store: Store[Record], records: Sequence[Record], reference: str | None = None
) -> dict[str, Any]:
    """Write and return the content of the result file: settings, numbers, provenance.

    Args:
        benchmark: What was run.
        store: Its folder.
        records: Its episodes.
        reference: Method that all others are tested against; dexflex if None.
    """
    identity = store.identity()
    result = {
        "config_hash": identity_digest(identity),
        "identity": identity,
        "tuning": benchmark.tuning,
        "n_episodes": benchmark.episodes,
        "first_seed": benchmark.first_seed,
        "seeds": [min(r.seed for r in records), max(r.seed for r in records)],
        "methods": list(benchmark.methods),
        "versions": {r.method: r.version for r in records},
        **summarise(records, benchmark.methods, benchmark.cells, reference),
        "provenance": session_provenance(store.sessions()),
    }
    write_json(benchmark.output / RESULT, result)
    return result


def write_report(
    benchmark: Benchmark, result: dict[str, Any], records: Sequence[Record], films: bool = True
) -> Path:
    """Write the tables and the page into the benchmark's folder and return the page's path.

    Args:
        benchmark: What was run.
        result: From `make_result`.
        records: Its episodes.
        films: Whether to run an episode again to film it.
    """
    (benchmark.output / TABLES).write_text(tables.markdown(result) + "\n")
    removals = [c for c in benchmark.cells if Cell.parse(c).corruption.family == "removal"]
    header = tables.metric_header(result)
    sections = [
        "<h1>Degraded commands: who recovers the intent?</h1>",
        f"<p>{html.escape(tables.about(result))}</p>",
        picture(
            plots.bars(result), "Duration, progress and intent error per condition, bootstrap 95 % intervals."
        ),
        "<h2>Task progress</h2>",
        table(header, tables.metric_rows(result, "progress")),
        f"<h2>{html.escape(result['reference'])} against the others</h2>",
        table(tables.TEST_HEADER, tables.test_rows(result, [FAMILIES, *result["cells"]])),
        *_pictures(result, records, removals),
        *(_films(benchmark, records, result["reference"], removals[-1]) if films and removals else ()),
        *_more_tables(result, header),
        provenance(result),
    ]
    return write_page(benchmark.output / PAGE, document("Degraded commands", sections))


def _pictures(result: dict[str, Any], records: Sequence[Record], removals: Sequence[str]) -> Iterable[str]:
    yield "<h2>Selective intervention</h2>"
    if drawn := plots.around_removals(result):
        yield picture(drawn, "Mean intervention around removals with 95 % intervals; low outside is the aim.")
    if removals:
        first = [r for r in records if r.cell == removals[-1] and r.episode == 0]
        shown = [m for m in plots.main_methods(result["methods"]) if Method.parse(m).learned or m == "reflex"]
        if drawn := plots.episode_interventions(first, shown):
            yield picture(drawn, f"Episode 0 in {removals[-1]}, chosen by number.")
    if drawn := plots.gains(result):
        yield "<h2>Is it more than damping?</h2>"
        yield picture(drawn, "Progress over the output gain: what shrinking alone achieves.")
    if drawn := plots.ablations(result):
        yield "<h2>Ablations</h2>"
        yield picture(drawn, "Progress without one part at a time; as many candidates each.")


def _films(benchmark: Benchmark, records: Sequence[Record], reference: str, cell: str) -> Iterable[str]:
    episode = choose_episode(records, cell, reference)
    if episode is None or reference == "raw":
        return
    chain = benchmark.book(Cell.parse(cell).verified).load(episode + 1)[episode]
    path = film(chain, episode, cell, ("raw", reference), benchmark.output, benchmark.controller)
    yield "<h2>One episode</h2>"
    yield video(
        path,
        f"Episode {episode} in {cell}: the first that raw drops and {reference} does not, so a selection; "
        "run again alone, twice real time.",
    )


def _more_tables(result: dict[str, Any], header: Sequence[str]) -> Iterable[str]:
    for metric, title in tables.TITLES.items():
        if metric != "progress":
            yield f"<h2>{html.escape(title)}</h2>"
            yield table(header, tables.metric_rows(result, metric))
    yield "<h2>Dropped episodes</h2>"
    yield table(header, tables.drop_rows(result))
    if rows := tables.split_rows(result):
        yield "<h2>In and outside removals</h2>"
        yield table(tables.SPLIT_HEADER, rows)
