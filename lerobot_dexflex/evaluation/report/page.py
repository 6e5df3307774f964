"""The report: one HTML file with everything inside."""

import base64
import html
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from lerobot_dexflex.evaluation.outcome import Outcome
from lerobot_dexflex.evaluation.report import plots, table
from lerobot_dexflex.evaluation.report.film import side_by_side
from lerobot_dexflex.evaluation.summary import by_interface

_STYLE = """
:root { color-scheme: light dark; --ink: #1c2128; --soft: #59636e; --page: #fff;
        --line: #d8dee4; --card: #f6f8fa }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e3e8ee; --soft: #98a2ae; --page: #14171b; --line: #343b44; --card: #1c2127 }
}
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--page); margin: 0 auto;
       padding: 2rem 1.2rem; max-width: 60rem }
h1 { font-size: 1.5rem; margin: 0 } h2 { font-size: 1.1rem; margin: 2rem 0 .6rem }
p, figcaption, small { color: var(--soft) } figure { margin: 0 0 1rem }
.scroll { overflow-x: auto } table { border-collapse: collapse; font-variant-numeric: tabular-nums }
th, td { text-align: left; padding: .35rem .8rem .35rem 0; border-bottom: 1px solid var(--line);
         white-space: nowrap }
th { color: var(--soft); font-weight: 500 } td:first-child { font-weight: 600 }
.row { display: flex; flex-wrap: wrap; gap: 1rem } .row figure { flex: 1 1 17rem }
img, video { max-width: 100% } video { border-radius: 6px; width: 100% }
pre { background: var(--card); padding: .8rem; overflow-x: auto; border-radius: 6px; font-size: 13px }
"""


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
    temporary = path.with_suffix(".html.part")
    temporary.write_text(_page(result, outcomes, folder, videos))
    temporary.replace(path)
    return path


def _page(result: dict[str, Any], outcomes: Sequence[Outcome], folder: Path, videos: int) -> str:
    interfaces = list(result["per_interface"])
    grouped = by_interface(outcomes, interfaces)
    period = plots.period_of(outcomes)
    first, last = result["seeds"]
    sections = [
        f"<h1>{html.escape(result['identity']['env'])}: {html.escape(', '.join(interfaces))}</h1>",
        f"<p>{result['n_episodes']} paired episodes per interface (seeds {first} to {last}): the same "
        "initial states for every interface, with the same policy noise where they share a checkpoint.</p>",
        _table(table.RATE_HEADER, table.rate_rows(result)),
        '<div class="row">',
        _picture(plots.success(result), "Success rates with Wilson 95 % intervals."),
        _picture(plots.progress(grouped, period), "Mean progress; bands are bootstrap 95 % intervals."),
        _picture(plots.completion(grouped, period), "Share of episodes solved within a time."),
        "</div>",
        "<h2>Paired outcomes</h2>",
        _picture(plots.paired(grouped), "How each episode ended under each interface."),
        _table(table.PAIR_HEADER, table.pair_rows(result)) if len(interfaces) > 1 else "",
        "<p>Only first / only second: episodes that just one of the two solved. McNemar's exact test, "
        "adjusted by Holm over all pairs; progress gain with bootstrap 95 % interval.</p>",
        *_videos(interfaces, folder, min(videos, result["n_episodes"])),
        "<h2>Provenance</h2>",
        f"<pre>{html.escape(_provenance(result))}</pre>",
    ]
    title = f"{result['identity']['env']} interfaces"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>"
        + "\n".join(sections)
        + "</body></html>\n"
    )


def _videos(interfaces: Sequence[str], folder: Path, videos: int) -> Iterable[str]:
    shown = []
    for episode in range(videos):
        films = [folder / "videos" / f"{episode:04d}_{name}.mp4" for name in interfaces]
        if not all(film.exists() for film in films):
            continue
        path = folder / "videos" / f"{episode:04d}_side_by_side.mp4"
        side_by_side(films, path)
        shown.append(
            f'<figure><video controls loop muted playsinline preload="metadata" src="{_data(path)}"></video>'
            f"<figcaption>Episode {episode}, twice real time.</figcaption></figure>"
        )
    if shown:
        yield f"<h2>The first {len(shown)} episodes, chosen by number</h2>"
        yield from shown


def _data(video: Path) -> str:
    return f"data:video/mp4;base64,{base64.b64encode(video.read_bytes()).decode()}"


def _picture(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode()
    return (
        f'<figure><img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'


def _provenance(result: dict[str, Any]) -> str:
    settings = [f"{key}: {value}" for key, value in result["identity"].items()]
    sessions = [
        f"{s['started']} commit {s['commit']}: {s['episodes_run']} episodes in {s['wall_time_s']} s with "
        f"{s['workers']} workers\n  $ {s['command']}"
        for s in result["provenance"]["sessions"]
    ]
    return "\n".join([f"settings {result['config_hash']}", *settings, "", *sessions])
