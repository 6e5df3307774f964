"""Draw the committed results, as pictures beside this script.

python docs/render_results.py

results.png: success of the interfaces on every task, with clean and with spoilt commands, from
eval/results/tasks.csv. degraded.png and removals.png: figures of the in-hand benchmark, from reach.csv there.
"""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_dexflex.evaluation.reach import plots
from lerobot_dexflex.evaluation.reach.summary import summarise as summarise_benchmark
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_panels, png
from lerobot_dexflex.evaluation.summary import newest, summarise
from lerobot_dexflex.runs.statistics import Rate
from lerobot_dexflex.runs.table import read

RESULTS = Path(__file__).resolve().parents[1] / "eval/results"
TASKS = ("PourCup-v0", "PlaceHammer-v0", "AssembleTable-v0")
CONDITIONS = {
    "clean": "clean commands",
    "removal_2mm": "the most loaded finger is taken off the object now and then",
    "noise_4mm": "±4 mm of noise on the planned fingertips",
}
"""Conditions and their meanings, a panel each."""
INTERFACES = ("joint", "raw", "press", "dexgen", "dexflex")
BENCHMARK = (
    ("press", "dexgen", "dexflex"),
    ("clean", "noise_2mm", "scale_1.5", "delay_2", "removal_2mm"),
)
"""Methods and conditions of the in-hand benchmark's figures."""
SPREAD = 0.7
"""Width of a group of interfaces; the groups' distance is 1."""


def main() -> None:
    """Draw all that there are rows of."""
    benchmark = summarise_benchmark(newest(read(RESULTS / "reach.csv")), *BENCHMARK)
    around = plots.around_removals(benchmark)
    assert around is not None
    pictures = {"results": success(), "degraded": plots.bars(benchmark), "removals": around}
    for name, picture in pictures.items():
        Path(__file__).with_name(f"{name}.png").write_bytes(picture)


def success() -> bytes:
    """Draw success on every task and on average, a panel per condition."""
    rows = newest(read(RESULTS / "tasks.csv"))
    shifts = np.linspace(-SPREAD / 2, SPREAD / 2, len(INTERFACES))
    looks = [(name, shift, colour(k)) for k, (name, shift) in enumerate(zip(INTERFACES, shifts, strict=True))]
    figure, panels = new_panels(9.0, 7.0, len(CONDITIONS))
    for axes, (condition, meaning) in zip(panels, CONDITIONS.items(), strict=True):
        part = rows.loc[(rows["condition"] == condition) & rows["task"].isin(TASKS)]
        run = [name for name in INTERFACES if name in set(part["method"])]
        summary = summarise(part, run, columns=TASKS)
        for name, shift, ink in looks:
            if name in run:
                _draw(axes, [summary.rates[name, column] for column in summary.columns], shift, ink)
        axes.set_xticks(range(len(summary.columns)), [c.removesuffix("-v0") for c in summary.columns])
        axes.set(ylim=(-3, 103), ylabel="success [%]")
        axes.set_title(meaning, color=INK, fontsize=9, loc="left")
    for name, _, ink in looks:
        panels[0].plot([], [], "o", color=ink, label=name)
    panels[0].legend(ncols=len(INTERFACES), loc="lower center", bbox_to_anchor=(0.5, 1.12), **LEGEND)
    return png(figure)


def _draw(axes: Any, rates: list[Rate], shift: float, ink: str) -> None:
    for k, rate in enumerate(rates):
        centre, (low, high) = rate.pc_success, rate.pc_success_ci95
        error = np.clip([[centre - low], [high - centre]], 0, None)
        axes.errorbar(k + shift, centre, error, fmt="o", color=ink, capsize=3)


if __name__ == "__main__":
    main()
