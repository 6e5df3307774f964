"""Draw the committed results, as pictures beside this script.

python docs/render_results.py

results.png: success of the interfaces below a live operator on every task; policies.png: below policies, over
three trainings; tools.png: below a person who uses tools; selectivity.png: how much more they change drafts
there where contacts begin or end than in calm. All from the rows and views of eval/readme_table.py.
degraded.png and removals.png: figures of the in-hand benchmark, from reach.csv.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_dexflex.evaluation.reach import plots
from lerobot_dexflex.evaluation.reach.summary import summarise as summarise_benchmark
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_figure, png
from lerobot_dexflex.evaluation.summary import AVERAGE, Summary, newest
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
    operator, policies, tools = summaries()
    pictures = {"results": success(operator), "policies": success(policies), "tools": success(tools)}
    pictures["selectivity"] = selectivity(tools)
    pictures |= {"degraded": plots.bars(benchmark), "removals": around}
    for name, picture in pictures.items():
        Path(__file__).with_name(f"{name}.png").write_bytes(picture)


def summaries() -> tuple[Summary, Summary, Summary]:
    """Return what the tables say of a live operator, of policies, and of a person who uses tools."""
    sys.path.insert(0, str(ROOT / "eval"))
    from readme_table import VIEWS, alone, pooled

    policies = pooled(VIEWS["policies"], ["clean"]).summary
    return alone(VIEWS["operator"], ["typical"]), policies, alone(VIEWS["tools"], ["novice"])


def success(summary: Summary) -> bytes:
    """Draw success on every task and on average, there with the methods' letters, see `Summary.letters`."""
    figure, axes = new_figure(9.0, 3.2)
    last = len(summary.columns) - 1
    rates = [[summary.rates[name, column] for column in summary.columns] for name in summary.methods]
    shifts = _draw(
        axes,
        {
            name: [(r.pc_success, r.pc_success_ci95) for r in row]
            for name, row in zip(summary.methods, rates, strict=True)
        },
    )
    for name, row, shift in zip(summary.methods, rates, shifts, strict=True):
        top = row[-1].pc_success_ci95[1]
        axes.text(last + shift, top + 2, summary.letters.get(name, ""), color=INK, ha="center", fontsize=8)
    _label(axes, summary.columns)
    axes.set(ylim=(-3, 103), ylabel="success [%], Wilson 95 %")
    return png(figure)


def selectivity(summary: Summary) -> bytes:
    """Draw how many times larger changes are around contact events than in calm, of those that change."""
    figure, axes = new_figure(9.0, 3.2)
    tasks = [column for column in summary.columns if column != AVERAGE]
    parts = [replace(summary, rows=summary.rows.loc[summary.rows["task"] == task]) for task in tasks]
    found = {
        name: [part.ratio(name, "change_event", "change_calm") for part in parts] for name in summary.methods
    }
    _draw(
        axes,
        {
            name: [(r.mean, r.ci95 or (r.mean, r.mean)) for r in ratios if r is not None]
            for name, ratios in found.items()
        },
    )
    axes.axhline(1, color=INK, lw=0.8, ls=":")
    _label(axes, tasks)
    axes.set(ylim=(0, None), ylabel="change at contacts / in calm")
    return png(figure)


def _draw(axes: Any, found: dict[str, list[tuple[float, tuple[float, float]]]]) -> list[float]:
    """Draw a group of points with intervals per column, of methods that have some.

    Returns how far each method is from the middle.
    """
    shifts = np.linspace(-SPREAD / 2, SPREAD / 2, len(found)).tolist()
    for k, (name, points) in enumerate(found.items()):
        for column, (centre, (low, high)) in enumerate(points):
            error = np.clip([[centre - low], [high - centre]], 0, None)
            axes.errorbar(column + shifts[k], centre, error, fmt="o", color=colour(k), capsize=3)
        if points:
            axes.plot([], [], "o", color=colour(k), label=_told(name, found))
    axes.legend(ncols=min(len(found), 4), loc="lower center", bbox_to_anchor=(0.5, 1.02), **LEGEND)
    return shifts


def _told(name: str, names: Iterable[str]) -> str:
    """Return a name without the splitter, and without a source that all names share."""
    name = name.removesuffix(":use_splitter=True")
    alike = len({other.rpartition("/")[0] for other in names}) == 1
    return name.rpartition("/")[2] if alike else name


def _label(axes: Any, columns: Sequence[str]) -> None:
    axes.set_xticks(range(len(columns)), [column.removesuffix("-v0") for column in columns])


if __name__ == "__main__":
    main()
