"""The figures of the report, as PNG, transparent and in colours that read on light and dark pages."""

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from lerobot_dexflex.evaluation.failures import endings
from lerobot_dexflex.evaluation.report.canvas import INK, LEGEND, colour, new_figure, png
from lerobot_dexflex.evaluation.summary import Summary

_ENDINGS = {"success": "#3bb273", "dropped": "#e0566b", "time out": "#d9a93a"}


def success(summary: Summary) -> bytes:
    """Draw success rates with Wilson intervals, the average over columns if there is one.

    At the right stand the methods' letters: who shares one does not differ significantly; see
    `Summary.letters`.
    """
    figure, axes = new_figure(3.6, 2.5)
    letters, margin = summary.letters, axes.get_yaxis_transform()
    for k, name in enumerate(summary.methods):
        found = summary.rates.get((name, summary.columns[-1]))
        if found is None:
            continue
        rate, (low, high) = found.pc_success, found.pc_success_ci95
        # A rate of 0 or 100 % lies on the interval's edge up to rounding.
        error = np.clip([[rate - low], [high - rate]], 0, None)
        axes.errorbar(rate, k, xerr=error, fmt="o", color=colour(k), capsize=4, lw=2)
        axes.text(rate, k - 0.28, f"{rate:.0f} %", color=INK, ha="center", va="center", fontsize=8)
        axes.text(1.02, k, letters.get(name, ""), color=INK, va="center", fontsize=8, transform=margin)
    axes.set(xlim=(-8, 108), ylim=(len(summary.methods) - 0.5, -0.6), xlabel="success [%], Wilson 95 %")
    axes.set_yticks(range(len(summary.methods)), list(summary.methods))
    return png(figure)


def paired(summary: Summary) -> bytes:
    """Draw every episode under every method; a column is one initial state, blank where it was not run."""
    figure, axes = new_figure(7.0, 0.32 * len(summary.methods) + 0.75)
    seeds = sorted(set(summary.rows["seed"]))
    grid = np.full((len(summary.methods), len(seeds)), np.nan)
    order = list(_ENDINGS)
    for k, name in enumerate(summary.methods):
        episodes = summary.of(name)
        columns = np.searchsorted(seeds, episodes["seed"])
        grid[k, columns] = [order.index(ending) for ending in endings(episodes)]
    colours = ListedColormap(list(_ENDINGS.values()))
    axes.pcolormesh(
        np.ma.masked_invalid(grid), cmap=colours, vmin=-0.5, vmax=2.5, edgecolors="#80879255", linewidth=0.3
    )
    axes.set_yticks(np.arange(len(summary.methods)) + 0.5, list(summary.methods))
    axes.invert_yaxis()
    axes.set_xlabel("episode (same initial state in a column)")
    handles = [Figure().add_subplot().plot([], [], "s", color=c, label=n)[0] for n, c in _ENDINGS.items()]
    axes.legend(handles=handles, ncols=3, loc="lower left", bbox_to_anchor=(0, 1), **LEGEND)
    return png(figure)


def completion(summary: Summary) -> bytes:
    """Draw the share of episodes solved within a time."""
    figure, axes = new_figure(3.6, 2.5)
    end = float(summary.rows["seconds"].max())
    for k, name in enumerate(summary.methods):
        episodes = summary.of(name)
        times = sorted(episodes.loc[episodes["success"].astype(bool), "seconds"])
        share = 100 * np.arange(len(times) + 1) / len(episodes)
        axes.step([0, *times, end], [*share, share[-1]], where="post", color=colour(k), label=name, lw=2)
    axes.set(xlabel="time [s]", ylabel="solved within [%]", ylim=(-3, 103))
    axes.legend(**LEGEND)
    return png(figure)
