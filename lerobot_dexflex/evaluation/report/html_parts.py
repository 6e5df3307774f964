"""Building blocks of self-contained HTML pages."""

import base64
import html
from collections.abc import Iterable, Sequence
from pathlib import Path

import pandas as pd

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


def document(title: str, sections: Iterable[str]) -> str:
    """Return a page with everything inside."""
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>"
        + "\n".join(sections)
        + "</body></html>\n"
    )


def write_page(path: Path, page: str) -> Path:
    """Write a page in one go and return its path."""
    temporary = path.with_suffix(".html.part")
    temporary.write_text(page)
    return temporary.replace(path)


def video(path: Path, caption: str) -> str:
    """Return a figure with a film inside."""
    return (
        f'<figure><video controls loop muted playsinline preload="metadata" src="{_data(path)}"></video>'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def _data(video: Path) -> str:
    return f"data:video/mp4;base64,{base64.b64encode(video.read_bytes()).decode()}"


def picture(png: bytes, caption: str) -> str:
    """Return a figure with a picture inside."""
    data = base64.b64encode(png).decode()
    return (
        f'<figure><img alt="{html.escape(caption)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of plain text."""
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'


def origins(runs: pd.DataFrame) -> str:
    """Return rows of `runs.csv`, where each version's episodes come from, as preformatted text."""
    text = "\n\n".join(
        f"{run['method']} {run['version']}, {run['date']}, commit {run['commit']}\n  code {run['code']} "
        f"weights {run['weights']} {run['settings']}\n  $ {run['command']}"
        for run in runs.fillna("").to_dict("records")
    )
    return f"<h2>Provenance</h2><pre>{html.escape(text)}</pre>"
