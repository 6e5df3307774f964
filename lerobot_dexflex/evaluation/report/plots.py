"""The figures of the report, as PNG, transparent and in colours that read on light and dark pages."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from scipy.stats import bootstrap

from lerobot_dexflex.evaluation.outcome import Outcome
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_figure, png

_ENDINGS = {"success": "#3bb273", "dropped": "#e0566b", "time out": "#d9a93a"}
_CURVE_POINTS = 60

Outcomes = dict[str, list[Outcome]]


def success(result: dict[str, Any]) -> bytes:
    """Draw success rates with Wilson intervals."""
    figure, axes = new_figure(3.6, 2.5)
    for k, numbers in enumerate(result["per_interface"].values()):
        rate, (low, high) = numbers["pc_success"], numbers["pc_success_ci95"]
        # A rate of 0 or 100 % lies on the interval's edge up to rounding.
        error = np.clip([[rate - low], [high - rate]], 0, None)
        axes.errorbar(rate, k, xerr=error, fmt="o", color=colour(k), capsize=4, lw=2)
        axes.text(rate, k - 0.28, f"{rate:.0f} %", color=INK, ha="center", va="center", fontsize=8)
    axes.set(
        xlim=(-8, 108), ylim=(len(result["per_interface"]) - 0.5, -0.6), xlabel="success [%], Wilson 95 %"
    )
    axes.set_yticks(range(len(result["per_interface"])), list(result["per_interface"]))
    return png(figure)


def paired(outcomes: Outcomes) -> bytes:
    """Draw every episode under every interface; a column is one initial state."""
    figure, axes = new_figure(7.0, 0.32 * len(outcomes) + 0.75)
    order = list(_ENDINGS)
    grid = np.array([[order.index(o.ending) for o in episodes] for episodes in outcomes.values()])
    colours = ListedColormap(list(_ENDINGS.values()))
    axes.pcolormesh(grid, cmap=colours, vmin=-0.5, vmax=2.5, edgecolors="#80879255", linewidth=0.3)
    axes.set_yticks(np.arange(len(outcomes)) + 0.5, list(outcomes))
    axes.invert_yaxis()
    axes.set_xlabel("episode (same initial state in a column)")
    handles = [Figure().add_subplot().plot([], [], "s", color=c, label=n)[0] for n, c in _ENDINGS.items()]
    axes.legend(handles=handles, ncols=3, loc="lower left", bbox_to_anchor=(0, 1), **LEGEND)
    return png(figure)


def progress(outcomes: Outcomes, period: float) -> bytes:
    """Draw mean progress over time with pointwise bootstrap 95 % bands."""
    figure, axes = new_figure(3.6, 2.5)
    horizon = max(o.steps for episodes in outcomes.values() for o in episodes)
    steps = np.unique(np.linspace(0, horizon, _CURVE_POINTS).round().astype(int))
    for k, (name, episodes) in enumerate(outcomes.items()):
        curves = np.stack([o.progress_at(steps) for o in episodes])  # (episodes, points)
        axes.plot(steps * period, curves.mean(0), color=colour(k), label=name, lw=2)
        if len(curves) > 1:
            interval = bootstrap(
                (curves,), np.mean, axis=0, n_resamples=999, method="percentile", rng=np.random.default_rng(0)
            ).confidence_interval
            axes.fill_between(steps * period, interval.low, interval.high, color=colour(k), alpha=0.18, lw=0)
    axes.set(xlabel="time [s]", ylabel="progress", ylim=(-0.03, 1.03))
    axes.legend(**LEGEND)
    return png(figure)


def completion(outcomes: Outcomes, period: float) -> bytes:
    """Draw the share of episodes solved within a time."""
    figure, axes = new_figure(3.6, 2.5)
    end = period * max(o.steps for episodes in outcomes.values() for o in episodes)
    for k, (name, episodes) in enumerate(outcomes.items()):
        times = sorted(o.completion_time for o in episodes if o.completion_time is not None)
        share = 100 * np.arange(len(times) + 1) / len(episodes)
        axes.step([0, *times, end], [*share, share[-1]], where="post", color=colour(k), label=name, lw=2)
    axes.set(xlabel="time [s]", ylabel="solved within [%]", ylim=(-3, 103))
    axes.legend(**LEGEND)
    return png(figure)


def period_of(episodes: Sequence[Outcome]) -> float:
    """Return the control period [s] that the outcomes imply; 50 ms if nothing succeeded."""
    for outcome in episodes:
        if outcome.completion_time is not None and outcome.steps:
            return outcome.completion_time / outcome.steps
    return 0.05
