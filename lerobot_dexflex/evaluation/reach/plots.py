"""The figures of the benchmark's report."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from lerobot_dexflex.evaluation.reach.bounds import CLEAN
from lerobot_dexflex.evaluation.reach.record import Record
from lerobot_dexflex.evaluation.reach.summary import FAMILIES
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_figure, new_panels, png
from lerobot_dexflex.interfaces.method import Method

BARS = {"duration": "duration", "progress": "task progress", "intent": "intent error"}
_PERIOD = 0.05
_SHOWN_GAINS = ("shrink", "dexgen", "dexflex")


def main_methods(methods: Sequence[str]) -> list[str]:
    """Return the methods of a figure: one of each kind, no ablation, and preferably at gain 1."""
    parsed = [method for name in methods if not (method := Method.parse(name)).ablation]
    shown: dict[str, str] = {}
    for method in sorted(parsed, key=lambda method: method.gain != 1.0):
        shown.setdefault(method.base, method.name)
    return [name for name in methods if name in shown.values()]


def bars(result: dict[str, Any]) -> bytes:
    """Draw duration, progress and intent error per cell and main method with bootstrap intervals."""
    methods, cells = main_methods(result["methods"]), result["cells"]
    figure, panels = new_panels(9.0, 6.6, len(BARS))
    width = 0.85 / len(methods)
    for axes, (metric, label) in zip(panels, BARS.items(), strict=True):
        for k, name in enumerate(methods):
            at = np.arange(len(cells)) + (k - (len(methods) - 1) / 2) * width
            means = [numbers[name][metric] for numbers in cells.values()]
            heights = [m["mean"] for m in means]
            error = np.array([_reach(m) for m in means]).T
            axes.bar(at, heights, 0.92 * width, color=colour(k), label=name)
            axes.errorbar(at, heights, yerr=error, fmt="none", ecolor=INK, elinewidth=0.8, capsize=1.5)
        axes.set(ylabel=label, ylim=(0, None))
        axes.set_xticks(range(len(cells)), list(cells))
    panels[0].legend(ncols=5, loc="lower left", bbox_to_anchor=(0, 1), **LEGEND)
    return png(figure)


def around_removals(result: dict[str, Any]) -> bytes | None:
    """Draw the mean intervention of the main methods around the first step of removals; None without any."""
    cells = {c: numbers for c, numbers in result["cells"].items() if _curves(numbers)}
    if not cells:
        return None
    figure, panels = new_panels(7.0, 2.2 * len(cells), len(cells))
    for axes, (cell, numbers) in zip(panels, cells.items(), strict=True):
        for k, name in enumerate(main_methods(result["methods"])):
            curve = numbers[name]["event_curve"]
            if not curve or name in ("raw", CLEAN):
                continue  # Raw never intervenes; the clean operator replaces the draft.
            lag, mean, low, high = np.array(curve).T
            axes.plot(_PERIOD * lag, mean, color=colour(k), lw=1.8, label=name)
            axes.fill_between(_PERIOD * lag, low, high, color=colour(k), alpha=0.18, lw=0)
        axes.axvspan(0, _PERIOD * 8, color=INK, alpha=0.15, lw=0)
        axes.set(ylabel=f"intervention, {cell}", ylim=(0, None))
    panels[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1), **LEGEND)
    panels[-1].set_xlabel("time after the first step of a removal [s]; grey: the removal")
    return png(figure)


def episode_interventions(records: Sequence[Record], methods: Sequence[str]) -> bytes | None:
    """Draw the intervention over one episode, removals in grey, contacts below; None without traces.

    Args:
        records: Of one cell and one episode.
        methods: Which to draw.
    """
    traced = {r.method: r.trace for r in records if r.trace and r.method in methods}
    if not traced:
        return None
    figure, panels = new_panels(9.0, 1.5 * len(traced) + 0.4, len(traced))
    for axes, (name, trace) in zip(panels, traced.items(), strict=True):
        time = _PERIOD * np.arange(len(trace["intervention"]))
        axes.plot(time, trace["intervention"], color=colour(methods.index(name)), lw=1.5)
        _shade(axes, time, np.array(trace["in_event"], bool))
        contacts = axes.twinx()
        contacts.step(time, trace["contacts"], color=INK, lw=0.8, where="post", alpha=0.7)
        contacts.set(ylim=(0, 4.3), yticks=(0, 2, 4))
        contacts.set_ylabel("contacts", color=INK, fontsize=8)
        contacts.tick_params(colors=INK, labelsize=8)
        contacts.spines[:].set_visible(False)
        axes.set(ylabel=name, ylim=(0, None))
    panels[-1].set_xlabel(
        "time [s]; colour: intervention, grey line: fingers in contact, grey area: removals"
    )
    return png(figure)


def gains(result: dict[str, Any]) -> bytes | None:
    """Draw progress over the output gain of shrink and of the learned methods; None with fewer than two."""
    curves = {base: _gain_curve(result, base) for base in _SHOWN_GAINS}
    curves = {base: curve for base, curve in curves.items() if len(curve) > 1}
    if not curves or not result[FAMILIES]:
        return None
    figure, axes = new_figure(4.6, 2.8)
    for k, (base, curve) in enumerate(curves.items()):
        at = sorted(curve)
        means = [result[FAMILIES][curve[g]]["progress"] for g in at]
        error = np.array([_reach(m) for m in means]).T
        style = {"color": colour(k), "capsize": 3, "lw": 1.8, "fmt": "o-", "label": base}
        axes.errorbar(at, [m["mean"] for m in means], yerr=error, **style)
    axes.set(xlabel="output gain (shrink at 1 is raw)", ylabel="progress, mean over families")
    axes.legend(**LEGEND)
    return png(figure)


def ablations(result: dict[str, Any]) -> bytes | None:
    """Draw progress, averaged over families, of dexflex and its ablations; None without any."""
    ablated = [m for m in result["methods"] if Method.parse(m).ablation]
    if not ablated or not result[FAMILIES]:
        return None
    names = [result["reference"], *ablated]
    figure, axes = new_figure(5.2, 0.34 * len(names) + 0.7)
    for k, name in enumerate(names):
        mean = result[FAMILIES][name]["progress"]
        error = np.array([_reach(mean)]).T
        axes.errorbar(mean["mean"], k, xerr=error, fmt="o", color=colour(0 if k == 0 else 4), capsize=3)
    axes.set(xlabel="progress, mean over families", ylim=(len(names) - 0.5, -0.5))
    axes.set_yticks(range(len(names)), names)
    return png(figure)


def _gain_curve(result: dict[str, Any], base: str) -> dict[float, str]:
    """Return method names by gain."""
    found = {}
    for name in result["methods"]:
        method = Method.parse(name)
        if base == "shrink" and name == "raw":
            found[1.0] = name
        elif method.base == base == "shrink" and method.gain == 1.0:
            found[float(dict(method.options).get("gain", 0.5))] = name
        elif method.base == base and base != "shrink" and not method.ablation and not method.options:
            found[method.gain] = name
    return found


def _curves(numbers: dict[str, Any]) -> bool:
    return any(values["event_curve"] for values in numbers.values())


def _shade(axes: Axes, time: Any, event: Any) -> None:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], event.astype(int), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(_PERIOD * begin, _PERIOD * end, color=INK, alpha=0.2, lw=0)


def _reach(mean: dict[str, Any]) -> tuple[float, float]:
    low, high = mean["ci95"] or (mean["mean"], mean["mean"])
    return max(0.0, mean["mean"] - low), max(0.0, high - mean["mean"])
