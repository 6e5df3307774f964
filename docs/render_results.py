"""Draw the committed results, as pictures beside this script.

python docs/render_results.py

results.png: success of the interfaces on every task, with clean and with spoilt commands. degraded.png and
removals.png: figures of the degraded-command benchmark's report.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_dexflex.evaluation.reach import plots
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_panels, png

RESULTS = Path(__file__).resolve().parents[1] / "eval/results"
RUNS = {
    "tasks": "clean commands",
    "tasks_removal": "the most loaded finger is taken off the object now and then",
    "tasks_noise": "±4 mm of noise on the commanded fingertips",
}
"""Result files and their meanings, a panel each."""
INTERFACES = ("joint", "raw", "filter", "shrink", "dexgen", "dexgen@0.6", "dexgen@0.4", "dexflex")
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
    """Draw success on every task and on average, a panel per condition."""
    shifts = np.linspace(-SPREAD / 2, SPREAD / 2, len(INTERFACES))
    looks = [(name, shift, colour(k)) for k, (name, shift) in enumerate(zip(INTERFACES, shifts, strict=True))]
    figure, panels = new_panels(9.0, 7.0, len(RUNS))
    for axes, (run, meaning) in zip(panels, RUNS.items(), strict=True):
        result = _result(run)
        columns = result["columns"]
        for name, shift, ink in looks:
            if rates := result["success"].get(name):
                _draw(axes, [rates[c] for c in columns], shift, ink)
        axes.set_xticks(range(len(columns)), [column.replace("_", " ") for column in columns])
        axes.set(ylim=(-3, 103), ylabel="success [%]")
        axes.set_title(meaning, color=INK, fontsize=9, loc="left")
    for name, _, ink in looks:
        panels[0].plot([], [], "o", color=ink, label=name)
    panels[0].legend(ncols=len(INTERFACES), loc="lower center", bbox_to_anchor=(0.5, 1.12), **LEGEND)
    return png(figure)


def _result(name: str) -> dict[str, Any]:
    return json.loads((RESULTS / f"{name}.json").read_text())


def _draw(axes: Any, rates: list[dict[str, Any]], shift: float, ink: str) -> None:
    for k, rate in enumerate(rates):
        centre, (low, high) = rate["pc_success"], rate["pc_success_ci95"]
        error = np.clip([[centre - low], [high - centre]], 0, None)
        axes.errorbar(k + shift, centre, error, fmt="o", color=ink, capsize=3)


if __name__ == "__main__":
    main()
