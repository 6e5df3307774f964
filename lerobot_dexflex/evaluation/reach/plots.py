"""The figures of the benchmark's report."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import REMOVAL_STEPS
from lerobot_dexflex.commands.loop import Episode
from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.reach.bounds import BOUNDS
from lerobot_dexflex.evaluation.reach.metrics import EVENT_BIN, EVENT_LAGS, relative_error
from lerobot_dexflex.evaluation.reach.summary import FAMILIES, Summary
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_figure, new_panels, png
from lerobot_dexflex.evaluation.report.interventions import Trace, interventions
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.statistics import Mean

BARS = {
    "progress": "task progress",
    "progress_budget": "in tight time",
    "duration": "duration",
    "intent": "intent error",
}
"""Metrics that are drawn, and their labels."""
_PERIOD = 0.05


def main_methods(methods: Sequence[str]) -> list[str]:
    """Return the methods of a figure: one of each kind, no ablation, and preferably at gain 1.

    Learned methods are of a kind if they have the base, others also if they take the same options.
    """
    parsed = [method for name in methods if not (method := Method.parse(name)).ablation]
    shown: dict[tuple[str, ...], str] = {}
    for method in sorted(parsed, key=lambda method: method.gain != 1.0):
        options = () if method.learned else tuple(key for key, _ in method.options)
        shown.setdefault((method.base, *options), method.name)
    return [name for name in methods if name in shown.values()]


def settings(summary: Summary) -> list[tuple[str, ...]]:
    """Return the sources and kinds of goals that were run, as `Condition.setting`, in order."""
    return list(dict.fromkeys(Condition.parse(name).setting for name in summary.run))


def bars(summary: Summary, setting: tuple[str, ...] = ()) -> bytes:
    """Draw `BARS` per error and main method with bootstrap intervals.

    Args:
        summary: What to draw.
        setting: Source and kind of goals, one of `settings`; by default drafts of motion, unverified goals.
    """
    methods = main_methods(summary.methods)
    conditions = [name for name in summary.run if Condition.parse(name).setting == setting]
    figure, panels = new_panels(9.0, 2.1 * len(BARS), len(BARS))
    width = 0.85 / len(methods)
    for axes, (metric, label) in zip(panels, BARS.items(), strict=True):
        for k, name in enumerate(methods):
            at = np.arange(len(conditions)) + (k - (len(methods) - 1) / 2) * width
            heights, error = _drawn([summary.mean(name, condition, metric) for condition in conditions])
            axes.bar(at, heights, 0.92 * width, color=colour(k), label=name)
            axes.errorbar(at, heights, yerr=error, fmt="none", ecolor=INK, elinewidth=0.8, capsize=1.5)
        axes.set(ylabel=label, ylim=(0, None))
        axes.set_xticks(range(len(conditions)), [Condition.parse(name).errors.name for name in conditions])
    panels[0].legend(ncols=5, loc="lower left", bbox_to_anchor=(0, 1), **LEGEND)
    return png(figure)


def around_removals(summary: Summary) -> bytes | None:
    """Draw the mean intervention of the main methods around the first step of removals; None without any.

    Methods that never intervene are left out, and so are bounds.
    """
    here = set(summary.rows.dropna(subset="around")["condition"])
    conditions = [name for name in summary.run if name in here and name.startswith("removal")]
    if not conditions:
        return None
    figure, panels = new_panels(7.0, 2.2 * len(conditions), len(conditions))
    middle = _PERIOD * (EVENT_LAGS + EVENT_BIN / 2)
    for axes, condition in zip(panels, conditions, strict=True):
        for k, name in enumerate(main_methods(summary.methods)):
            curves = _curves(summary.of(name, condition))
            seen = np.isfinite(curves).sum(0)
            enough = seen > 1
            if Method.parse(name).base in BOUNDS or not np.nan_to_num(curves[:, enough]).any():
                continue
            at, curves = middle[enough], curves[:, enough]
            mean = np.nanmean(curves, 0)
            # Of hundreds of episodes; the normal interval is that of the bootstrap to the drawn line's width.
            half = 1.96 * np.nanstd(curves, 0, ddof=1) / np.sqrt(seen[enough])
            axes.plot(at, mean, "o-", ms=3, color=colour(k), lw=1.8, label=name)
            axes.fill_between(at, mean - half, mean + half, color=colour(k), alpha=0.18, lw=0)
        axes.axvspan(0, _PERIOD * REMOVAL_STEPS, color=INK, alpha=0.15, lw=0)
        axes.set(ylabel=f"intervention, {condition}", ylim=(0, None))
    panels[0].legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1), **LEGEND)
    panels[-1].set_xlabel("time after the first step of a removal [s]; grey: the removal")
    return png(figure)


def episode(episodes: Mapping[str, Episode]) -> bytes:
    """Draw the intervention over one episode, removals in grey, fingers in contact behind.

    Args:
        episodes: The same episode by method.
    """
    traces = {
        name: Trace(
            relative_error(shown.selected, shown.draft),
            (shown.loads > CONTACT_FORCE).sum(1),
            shown.in_event,
        )
        for name, shown in episodes.items()
    }
    return interventions(traces, "intervention", "removals")


def gains(summary: Summary) -> bytes | None:
    """Draw progress over the gain of the motion, for methods that ran with several; None without any."""
    curves = {name: curve for name, curve in _gain_curves(summary.methods).items() if len(curve) > 1}
    if not curves or FAMILIES not in summary.conditions:
        return None
    figure, axes = new_figure(4.6, 2.8)
    for k, (name, curve) in enumerate(curves.items()):
        at = sorted(curve)
        heights, error = _drawn([summary.mean(curve[gain], FAMILIES, "progress") for gain in at])
        style = {"color": colour(k), "capsize": 3, "lw": 1.8, "fmt": "o-", "label": name}
        axes.errorbar(at, heights, yerr=error, **style)
    axes.set(xlabel="gain of the motion", ylabel="progress, mean over families")
    axes.legend(**LEGEND)
    return png(figure)


def ablations(summary: Summary) -> bytes | None:
    """Draw progress, averaged over families, of dexflex and its ablations; None without any."""
    ablated = [m for m in summary.methods if Method.parse(m).ablation]
    if not ablated or FAMILIES not in summary.conditions:
        return None
    names = [summary.reference, *ablated]
    figure, axes = new_figure(5.2, 0.34 * len(names) + 0.7)
    for k, name in enumerate(names):
        at, error = _drawn([summary.mean(name, FAMILIES, "progress")])
        axes.errorbar(at, k, xerr=error, fmt="o", color=colour(0 if k == 0 else 4), capsize=3)
    axes.set(xlabel="progress, mean over families", ylim=(len(names) - 0.5, -0.5))
    axes.set_yticks(range(len(names)), names)
    return png(figure)


def _curves(rows: pd.DataFrame) -> NDArray[np.float64]:
    """Return the interventions around removals, NaN where an episode has none. Shape (episodes, bins)."""
    texts = rows["around"].dropna().tolist()
    return np.array([text.split() for text in texts], float).reshape(-1, len(EVENT_LAGS))


def _gain_curves(methods: Sequence[str]) -> dict[str, dict[float, str]]:
    """Return, by the name without a gain, method names by gain."""
    found: dict[str, dict[float, str]] = {}
    for method in map(Method.parse, methods):
        found.setdefault(replace(method, gain=1.0).name, {})[method.gain] = method.name
    return found


def _drawn(means: Sequence[Mean | None]) -> tuple[list[float], NDArray[np.float64]]:
    """Return heights and how far their intervals reach down and up, (2, N); NaN where there is no mean."""
    heights = [np.nan if mean is None else mean.mean for mean in means]
    ends = [(h, h) if mean is None else mean.ci95 or (h, h) for h, mean in zip(heights, means, strict=True)]
    low, high = np.array(ends).T
    return heights, np.maximum([heights - low, high - heights], 0.0)
