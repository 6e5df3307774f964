"""The report: one HTML file with everything inside."""

import html
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.comparison import Comparison
from lerobot_dexflex.evaluation.report import plots, table
from lerobot_dexflex.evaluation.report.film import side_by_side
from lerobot_dexflex.evaluation.report.html_parts import document, origins, picture, video, write_page
from lerobot_dexflex.evaluation.report.html_parts import table as html_table
from lerobot_dexflex.evaluation.report.interventions import interventions, read_trace
from lerobot_dexflex.evaluation.summary import Summary, grown, summarise, write_eval_info
from lerobot_dexflex.runs.table import Table

MARKDOWN, PAGE, EVAL_INFO = "comparison.md", "report.html", "summary.json"


def write_report(comparison: Comparison, rows: pd.DataFrame) -> tuple[str, Path]:
    """Write the tables, the page and LeRobot's form of the rates into the comparison's folder.

    Args:
        comparison: What was run.
        rows: Its episodes.

    Returns:
        The tables as Markdown, and the page's path.

    Raises:
        DexFlexError: If a film cannot be read.
    """
    runs = Table(comparison.table).origins()
    methods = [comparison.named(method) for method in comparison.methods]
    grew = grown(runs)
    summaries = {
        condition: summarise(part, methods, "task", list(comparison.players), grew)
        for condition in comparison.conditions
        if not (part := rows.loc[rows["condition"] == condition]).empty
    }
    text = "\n\n".join(
        [*(table.markdown(found, _title(found)) for found in summaries.values()), table.MEANINGS]
    )
    (comparison.output / MARKDOWN).write_text(text + "\n")
    write_eval_info(rows, comparison.output / EVAL_INFO)
    title = f"{', '.join(comparison.players)}: {', '.join(methods)}"
    sections = [f"<h1>{html.escape(title)}</h1>", f"<p>{html.escape(table.MEANINGS)}</p>"]
    for condition, found in summaries.items():
        sections += _condition(comparison, condition, found, grew)
    shown = runs.loc[runs["version"].isin(rows["version"])]
    page = document(title, [*sections, origins(shown)])
    return text, write_page(comparison.output / PAGE, page)


def _title(summary: Summary) -> str:
    return table.summary_title(summary.rows)


def _condition(
    comparison: Comparison, condition: str, summary: Summary, grew: frozenset[str]
) -> Iterable[str]:
    yield f"<h2>{html.escape(condition)}</h2>"
    yield (
        f"<p>{html.escape(table.about(summary))} The same initial states for every method, with the same "
        "policy noise where they share a checkpoint.</p>"
    )
    if len(summary.columns) > 1:
        yield html_table(table.rate_header(summary), table.rate_rows(summary))
        yield picture(
            plots.success(summary), "Success over all tasks with Wilson 95 % intervals, and letters."
        )
    if summary.tests:
        yield html_table(table.pair_header(summary), table.pair_rows(summary))
    for task, part in summary.rows.groupby("task", sort=False):
        yield from _task(comparison, condition, str(task), summarise(part, summary.methods, grew=grew))


def _task(comparison: Comparison, condition: str, task: str, summary: Summary) -> Iterable[str]:
    yield f"<h3>{html.escape(task)}, {html.escape(condition)}</h3>"
    yield html_table(table.DETAIL_HEADER, table.detail_rows(summary))
    yield '<div class="row">'
    yield picture(plots.success(summary), "Success rates with Wilson 95 % intervals, and letters.")
    yield picture(plots.completion(summary), "Share of episodes solved within a time.")
    yield "</div>"
    yield picture(plots.paired(summary), "How each episode ended under each method.")
    if rows := table.selectivity_rows(summary):
        yield html_table(table.SELECTIVITY_HEADER, rows)
    stages = TASKS[task].stages if task in TASKS else ()
    if rows := table.failure_rows(summary, stages):
        yield html_table(table.failure_header(summary), rows)
    yield from _films(comparison, condition, task, summary)


def _films(comparison: Comparison, condition: str, task: str, summary: Summary) -> Iterable[str]:
    for seed in comparison.seeds[: comparison.videos]:
        films = [comparison.film(task, condition, seed, name) for name in summary.methods]
        if not all(film.exists() for film in films):
            continue
        path = comparison.film(task, condition, seed, "side_by_side")
        try:
            side_by_side(films, path)
            paths = {name: comparison.trace(task, condition, seed, name) for name in summary.methods}
            traces = {name: read_trace(trace) for name, trace in paths.items() if trace.exists()}
        except (OSError, EOFError, ValueError) as error:  # av's errors are among them.
            raise DexFlexError(
                f"A film or trace in {path.parent} of seed {seed} cannot be read ({error}). Remove that "
                "folder: the rows are kept, and the report goes without these films."
            ) from error
        yield video(path, f"Seed {seed}, twice real time.")
        if changing := {name: trace for name, trace in traces.items() if np.nan_to_num(trace.change).any()}:
            yield picture(
                interventions(changing, "change of the draft [mm]", "around contact events"),
                f"Seed {seed}: how far the interfaces sent the fingertips elsewhere than asked.",
            )
