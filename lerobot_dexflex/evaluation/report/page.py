"""The report: one HTML file with everything inside."""

import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from lerobot_dexflex.evaluation.outcome import Outcome
from lerobot_dexflex.evaluation.report import plots, table
from lerobot_dexflex.evaluation.report.film import side_by_side
from lerobot_dexflex.evaluation.report.html_parts import document, picture, provenance, video, write_page
from lerobot_dexflex.evaluation.report.html_parts import table as html_table
from lerobot_dexflex.evaluation.summary import by_interface


def write_report(result: dict[str, Any], outcomes: Sequence[Outcome], folder: Path, videos: int) -> Path:
    """Write `report.html` and `comparison.md` into the comparison's folder and return the page's path.

    Args:
        result: Content of the result file.
        outcomes: Its episodes.
        folder: Folder with the `videos` of the episodes.
        videos: How many episodes to show, if they were filmed.
    """
    (folder / "comparison.md").write_text(table.markdown(result) + "\n")
    path = folder / "report.html"
    return write_page(path, _page(result, outcomes, folder, videos))


def _page(result: dict[str, Any], outcomes: Sequence[Outcome], folder: Path, videos: int) -> str:
    interfaces = list(result["per_interface"])
    grouped = by_interface(outcomes, interfaces)
    period = plots.period_of(outcomes)
    first, last = result["seeds"]
    sections = [
        f"<h1>{html.escape(result['identity']['env'])}: {html.escape(', '.join(interfaces))}</h1>",
        f"<p>{result['n_episodes']} paired episodes per interface (seeds {first} to {last}): the same "
        "initial states for every interface, with the same policy noise where they share a checkpoint.</p>",
        html_table(table.RATE_HEADER, table.rate_rows(result)),
        '<div class="row">',
        picture(plots.success(result), "Success rates with Wilson 95 % intervals."),
        picture(plots.progress(grouped, period), "Mean progress; bands are bootstrap 95 % intervals."),
        picture(plots.completion(grouped, period), "Share of episodes solved within a time."),
        "</div>",
        "<h2>Paired outcomes</h2>",
        picture(plots.paired(grouped), "How each episode ended under each interface."),
        html_table(table.PAIR_HEADER, table.pair_rows(result)) if len(interfaces) > 1 else "",
        "<p>Only first / only second: episodes that just one of the two solved. McNemar's exact test, "
        "adjusted by Holm over all pairs; progress gain with bootstrap 95 % interval.</p>",
        *_failures(result),
        *_videos(interfaces, folder, min(videos, result["n_episodes"])),
        provenance(result),
    ]
    return document(f"{result['identity']['env']} interfaces", sections)


def _failures(result: dict[str, Any]) -> Iterable[str]:
    if rows := table.failure_rows(result):
        yield "<h2>What happened in the failures</h2>"
        yield html_table(table.failure_header(result), rows)


def _videos(interfaces: Sequence[str], folder: Path, videos: int) -> Iterable[str]:
    shown = []
    for episode in range(videos):
        films = [folder / "videos" / f"{episode:04d}_{name}.mp4" for name in interfaces]
        if not all(film.exists() for film in films):
            continue
        path = folder / "videos" / f"{episode:04d}_side_by_side.mp4"
        side_by_side(films, path)
        shown.append(video(path, f"Episode {episode}, twice real time."))
    if shown:
        yield f"<h2>The first {len(shown)} episodes, chosen by number</h2>"
        yield from shown
