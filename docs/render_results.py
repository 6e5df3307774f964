"""Draw the committed results, as pictures beside this script.

python docs/render_results.py

results.png: success of every interface on every task, with clean and with noisy commands. degraded.png and
removals.png: figures of the degraded-command benchmark's report.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_dexflex.evaluation.degraded import plots
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_figure, png

RESULTS = Path(__file__).resolve().parents[1] / "eval/results"
RUNS = {"tasks": ("o", "clean commands"), "tasks_noise": ("D", "±4 mm of noise on the planned fingertips")}
"""Result file by name: marker and meaning."""
SPREAD = 0.7
"""Width of a group of interfaces; the groups' distance is 1."""


def main() -> None:
    """Draw all of them."""
    degraded = _result("degraded")
    for name, picture in {
        "results": success(),
        "degraded": plots.bars(degraded),
        "removals": plots.around_removals(degraded),
    }.items():
        if picture:
            Path(__file__).with_name(f"{name}.png").write_bytes(picture)


def success() -> bytes:
    """Draw the averages over tasks."""
    runs = {name: _result(name) for name in RUNS}
    interfaces = list(runs["tasks"]["success"])
    columns = runs["tasks"]["columns"]
    places = dict(zip(interfaces, np.linspace(-SPREAD / 2, SPREAD / 2, len(interfaces)), strict=True))
    figure, axes = new_figure(9.0, 3.4)
    for run, (marker, _) in RUNS.items():
        for name, rates in runs[run]["success"].items():
            _draw(axes, [rates[c] for c in columns], places[name], colour(interfaces.index(name)), marker)
    for name in interfaces:
        axes.plot([], [], "o", color=colour(interfaces.index(name)), label=name)
    for marker, meaning in RUNS.values():
        axes.plot([], [], marker, color=INK, fillstyle=_fill(marker), label=meaning)
    axes.set_xticks(range(len(columns)), [column.replace("_", " ") for column in columns])
    axes.set(ylim=(-3, 103), ylabel="success [%], Wilson 95 %")
    axes.legend(ncols=len(interfaces) + len(RUNS), loc="lower center", bbox_to_anchor=(0.5, 1), **LEGEND)
    return png(figure)


def _result(name: str) -> dict[str, Any]:
    return json.loads((RESULTS / f"{name}.json").read_text())


def _draw(axes: Any, rates: list[dict[str, Any]], shift: float, ink: str, marker: str) -> None:
    for k, rate in enumerate(rates):
        centre, (low, high) = rate["pc_success"], rate["pc_success_ci95"]
        error = np.clip([[centre - low], [high - centre]], 0, None)
        axes.errorbar(k + shift, centre, error, fmt=marker, color=ink, fillstyle=_fill(marker), capsize=3)


def _fill(marker: str) -> str:
    return "full" if marker == "o" else "none"


if __name__ == "__main__":
    main()
