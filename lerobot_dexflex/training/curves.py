"""Curves of a stage's training, drawn from its `metrics.jsonl`."""

import json
from pathlib import Path

from matplotlib.figure import Figure


def plot_curves(folder: Path) -> Path:
    """Draw loss and held-out metrics over steps into `metrics.png`, one panel each; returns its path."""
    curves: dict[str, list[tuple[int, float]]] = {}
    for line in (folder / "metrics.jsonl").read_text().splitlines():
        entry = json.loads(line)
        values = {f"held-out {k}": v for k, v in entry.get("held_out", {}).items()}
        values |= {k: v for k, v in entry.items() if k not in ("step", "seconds", "held_out")}
        for name, value in values.items():
            curves.setdefault(name, []).append((entry["step"], value))
    columns = 4
    rows = max(1, -(-len(curves) // columns))
    figure = Figure(figsize=(4 * columns, 2.4 * rows), layout="constrained")
    for axes, (name, points) in zip(
        figure.subplots(rows, columns, squeeze=False).flat, curves.items(), strict=False
    ):
        axes.plot(*zip(*points, strict=True), marker="." if len(points) < 30 else None)
        axes.set_title(name.replace("_", " "), fontsize=9)
        axes.tick_params(labelsize=7)
        if name.startswith("loss"):
            axes.set_yscale("log")
    path = folder / "metrics.png"
    figure.savefig(path, dpi=80)
    return path
