"""Draw the committed results, as pictures beside this script.

python docs/render_results.py

results.png: success of the interfaces below a live operator on every task; policies.png: below policies, over
three trainings. Both from the rows and views of eval/readme_table.py.
degraded.png and removals.png: figures of the in-hand benchmark, from reach.csv.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_dexflex.evaluation.reach import plots
from lerobot_dexflex.evaluation.reach.summary import summarise as summarise_benchmark
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_figure, png
from lerobot_dexflex.evaluation.summary import Summary, newest
from lerobot_dexflex.runs.statistics import Rate
from lerobot_dexflex.runs.table import read

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval/results"
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
    operator, policies = summaries()
    pictures = {"results": success(operator), "policies": success(policies)}
    pictures |= {"degraded": plots.bars(benchmark), "removals": around}
    for name, picture in pictures.items():
        Path(__file__).with_name(f"{name}.png").write_bytes(picture)


def summaries() -> tuple[Summary, Summary]:
    """Return what the tables say of a live operator and of policies."""
    sys.path.insert(0, str(ROOT / "eval"))
    from readme_table import VIEWS, alone, pooled

    return alone(VIEWS["operator"], ["typical"]), pooled(VIEWS["policies"], ["clean"]).summary


def success(summary: Summary) -> bytes:
    """Draw success on every task and on average, there with the methods' letters, see `Summary.letters`."""
    methods, last = summary.methods, len(summary.columns) - 1
    figure, axes = new_figure(9.0, 3.2)
    for k, (name, shift) in enumerate(
        zip(methods, np.linspace(-SPREAD / 2, SPREAD / 2, len(methods)), strict=True)
    ):
        _draw(axes, [summary.rates[name, column] for column in summary.columns], shift, colour(k))
        axes.plot([], [], "o", color=colour(k), label=name)
        top = summary.rates[name, summary.columns[-1]].pc_success_ci95[1]
        letters = summary.letters.get(name, "")
        axes.text(last + shift, top + 2, letters, color=INK, ha="center", fontsize=8)
    axes.set_xticks(range(len(summary.columns)), [c.removesuffix("-v0") for c in summary.columns])
    axes.set(ylim=(-3, 103), ylabel="success [%], Wilson 95 %")
    columns = min(len(methods), 4)
    axes.legend(ncols=columns, loc="lower center", bbox_to_anchor=(0.5, 1.02), **LEGEND)
    return png(figure)


def _draw(axes: Any, rates: list[Rate], shift: float, ink: str) -> None:
    for k, rate in enumerate(rates):
        centre, (low, high) = rate.pc_success, rate.pc_success_ci95
        error = np.clip([[centre - low], [high - centre]], 0, None)
        axes.errorbar(k + shift, centre, error, fmt="o", color=ink, capsize=3)


if __name__ == "__main__":
    main()
