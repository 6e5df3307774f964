"""Empty figures in colours that read on light and dark pages, and their way into a page."""

import io
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK = "#808792"
LEGEND: dict[str, Any] = {"frameon": False, "labelcolor": INK, "fontsize": 8}
_PALETTE = (
    *("#4c8df6", "#e8973f", "#3bb273", "#c56be0", "#e0566b"),
    *("#2fb4c9", "#b5a642", "#8d6e63", "#9a8cf0", "#7f9aa8"),
)


def new_figure(width: float, height: float) -> tuple[Figure, Axes]:
    """Return a transparent figure of this size [inch] and its axes."""
    figure, panels = new_panels(width, height, 1)
    return figure, panels[0]


def new_panels(width: float, height: float, count: int) -> tuple[Figure, list[Axes]]:
    """Return a transparent figure of this size [inch] with panels one below the other."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.patch.set_alpha(0)
    panels = [figure.add_subplot(count, 1, k + 1) for k in range(count)]
    for axes in panels:
        axes.patch.set_alpha(0)
        axes.tick_params(colors=INK, labelsize=8)
        for side, spine in axes.spines.items():
            spine.set_color(INK)
            spine.set_visible(side in ("left", "bottom"))
        axes.xaxis.label.set(color=INK, fontsize=9)
        axes.yaxis.label.set(color=INK, fontsize=9)
    return figure, panels


def png(figure: Figure) -> bytes:
    """Return a figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150, transparent=True, metadata={"Software": None})
    return buffer.getvalue()


def colour(k: int) -> str:
    """Return the colour of the k-th curve."""
    return _PALETTE[k % len(_PALETTE)]
