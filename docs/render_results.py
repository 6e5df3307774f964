"""Draw the committed results, as pictures beside this script.

python docs/render_results.py

results.png: success of the interfaces below a live operator on every task, from eval/results/tasks.csv.
degraded.png and removals.png: figures of the in-hand benchmark, from reach.csv there.
"""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_dexflex.evaluation.reach import plots
from lerobot_dexflex.evaluation.reach.summary import summarise as summarise_benchmark
from lerobot_dexflex.evaluation.report.canvas import LEGEND, colour, new_figure, png
from lerobot_dexflex.evaluation.summary import newest, summarise
from lerobot_dexflex.runs.statistics import Rate
from lerobot_dexflex.runs.table import read

RESULTS = Path(__file__).resolve().parents[1] / "eval/results"
TASKS = ("PourCup-v0", "PlaceHammer-v0", "AssembleTable-v0")
INTERFACES = (
    "operator/joint",
    "operator-pressing/raw",
    "operator/press:4",
    "operator/dexgen",
    "operator/dexflex",
)
BENCHMARK = (
    ("press", "dexgen", "dexflex"),
    ("clean", "noise_2mm", "scale_1.5", "delay_2", "removal_2mm"),
)
"""Methods and conditions of the in-hand benchmark's figures."""
SPREAD = 0.7
"""Width of a group of interfaces; the groups' distance is 1."""


def main() -> None:
    """Draw all of them."""
    benchmark = summarise_benchmark(newest(read(RESULTS / "reach.csv")), *BENCHMARK)
    around = plots.around_removals(benchmark)
    assert around is not None
    pictures = {"results": success(), "degraded": plots.bars(benchmark), "removals": around}
    for name, picture in pictures.items():
        Path(__file__).with_name(f"{name}.png").write_bytes(picture)


def success() -> bytes:
    """Draw success on every task and on average."""
    rows = newest(read(RESULTS / "tasks.csv"))
    shifts = np.linspace(-SPREAD / 2, SPREAD / 2, len(INTERFACES))
    looks = [(name, shift, colour(k)) for k, (name, shift) in enumerate(zip(INTERFACES, shifts, strict=True))]
    figure, axes = new_figure(9.0, 3.2)
    part = rows.loc[(rows["condition"] == "typical") & rows["task"].isin(TASKS)]
    summary = summarise(part, list(INTERFACES), columns=TASKS)
    for name, shift, ink in looks:
        _draw(axes, [summary.rates[name, column] for column in summary.columns], shift, ink)
        axes.plot([], [], "o", color=ink, label=name)
    axes.set_xticks(range(len(summary.columns)), [c.removesuffix("-v0") for c in summary.columns])
    axes.set(ylim=(-3, 103), ylabel="success [%]")
    axes.legend(ncols=len(INTERFACES), loc="lower center", bbox_to_anchor=(0.5, 1.12), **LEGEND)
    return png(figure)


def _draw(axes: Any, rates: list[Rate], shift: float, ink: str) -> None:
    for k, rate in enumerate(rates):
        centre, (low, high) = rate.pc_success, rate.pc_success_ci95
        error = np.clip([[centre - low], [high - centre]], 0, None)
        axes.errorbar(k + shift, centre, error, fmt="o", color=ink, capsize=3)


if __name__ == "__main__":
    main()
