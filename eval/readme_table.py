"""Fill the result tables of docs/results.md and the checkpoints' cards from the committed results.

python eval/readme_table.py

`<!-- results:NAME -->` ... `<!-- /results -->` is filled from `eval/results/NAME.json`, which is the
`comparison.json` of a run of `eval/compare_interfaces.py`, the output of `eval/across_tasks.py`, or the
`degraded_commands.json` of `eval/degraded_commands.py`.
"""

import json
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
_BLOCK = re.compile(r"<!-- results:(?P<name>\w+) -->\n.*?<!-- /results -->", re.DOTALL)
_HEADER = "| interface | success | 95 % interval (Wilson) | time to success |\n|---|---|---|---|"


def names(text: str) -> list[str]:
    """Return the names of the results that a document shows."""
    return [block["name"] for block in _BLOCK.finditer(text)]


def documents() -> list[Path]:
    """Return the documents that show results."""
    return [
        ROOT / "docs/results.md",
        *sorted((ROOT / "policies/checkpoints").glob("*_*/README.md")),
    ]


def filled(text: str, results: Path, up: str = "") -> str:
    """Return a document with its result tables made anew.

    Args:
        text: Markdown with result blocks.
        results: Folder of the result files.
        up: Way from the document to the repository's root, such as `../../`.

    Raises:
        FileNotFoundError: If a block names a result that is not in the folder.
    """

    def block(match: re.Match[str]) -> str:
        name = match["name"]
        result = json.loads((results / f"{name}.json").read_text())
        content = _content(result, f"{up}eval/results/{name}.json")
        return f"<!-- results:{name} -->\n{content}\n<!-- /results -->"

    return _BLOCK.sub(block, text)


def up(document: Path) -> str:
    """Return the way from a document to the repository's root."""
    return "../" * (len(document.relative_to(ROOT).parts) - 1)


def _content(result: dict[str, Any], source: str) -> str:
    if "cells" in result:
        return degraded_table(result, source)
    if "columns" in result:
        from lerobot_dexflex.evaluation.report.table import across_markdown

        return f"{across_markdown(result)} [{source}]({source})."
    return table(result, source)


def table(result: dict[str, Any], source: str) -> str:
    """Return rates, intervals and paired tests of a comparison as Markdown.

    Args:
        result: Content of a `comparison.json`.
        source: Path of that file from the repository's root.
    """
    from lerobot_dexflex.evaluation.report.table import paired_sentence

    rows = [_row(name, numbers) for name, numbers in result["per_interface"].items()]
    first, last = result["seeds"]
    tests = paired_sentence(result["pairwise"])
    paired = f" Exact McNemar tests (Holm): {tests}." if tests else ""
    return (
        "\n".join([_HEADER, *rows])
        + f"\n\nn = {result['n_episodes']} paired episodes per interface on held-out initial states "
        + f"(seeds {first} to {last}).{paired} Every episode: [{source}]({source})."
    )


def degraded_table(result: dict[str, Any], source: str) -> str:
    """Return the task progress of every method and the reference's paired tests on the family average.

    Args:
        result: Content of a `degraded_commands.json`.
        source: Path of that file from the repository's root.
    """
    from lerobot_dexflex.evaluation.reach import tables

    progress = tables.as_markdown(tables.metric_header(result), tables.metric_rows(result, "progress"))
    tests = [
        f"`{t['method']}` {t['gain']['mean']:+.2f} (p = {t['p_value_holm']:.2g})"
        for t in result["tests"]
        if t["cell"] == "families"
    ]
    gains = f" Gain of `{result['reference']}` in the family average, Wilcoxon and Holm: {', '.join(tests)}."
    return f"{progress}\n\nMean progress with bootstrap 95 % intervals.{gains} [{source}]({source})."


def _row(name: str, numbers: dict[str, Any]) -> str:
    low, high = numbers["pc_success_ci95"]
    duration = numbers["completion_time"]
    time = f"{duration['mean']:.1f} s" if duration else "-"
    count = f"{numbers['n_success']}/{numbers['n_episodes']}"
    return f"| `{name}` | {numbers['pc_success']:.0f} % ({count}) | {low:.0f} to {high:.0f} % | {time} |"


if __name__ == "__main__":
    for document in documents():
        document.write_text(filled(document.read_text(), ROOT / "eval/results", up(document)))
