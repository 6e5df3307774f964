"""What an interface changed over an episode, and where contacts began or ended (paper, Fig. 4)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.evaluation.events import Flags, around, contact_events
from lerobot_dexflex.evaluation.outcome import Ended, Motion
from lerobot_dexflex.evaluation.report.canvas import INK, colour, new_panels, png

_PERIOD = 0.05
"""Control period [s]."""
_MOST = 4
"""Fingers that the scale of contacts has room for at least."""


class Trace(NamedTuple):
    """One episode of one interface, by control step."""

    change: NDArray[np.float64]
    """How much it changed the draft, in the picture's unit. Shape (steps,)."""
    fingers: NDArray[np.int64]
    """Fingers in contact with the object. Shape (steps,)."""
    marked: Flags
    """Steps that are shaded. Shape (steps,)."""


class TraceFile:
    """Keeps one episode's changes [mm] and contact events, for `interventions`.

    Args:
        path: The npy file; its folder is created.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._contacts: list[Flags] = []
        self._changes: list[float] = []

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """Keep the contacts of the state, and the change of the draft that led to it."""
        del env, observation
        if "contacts" not in info:
            return
        if self._contacts:
            self._changes.append(np.nan if motion is None else motion.change())
        self._contacts.append(info["contacts"])

    def close(self, outcome: Ended) -> None:
        """Write the file."""
        del outcome
        if not self._contacts:
            return
        contacts = np.array(self._contacts)
        near = around(contact_events(contacts))
        trace = Trace(np.array(self._changes), contacts[1:, :-1].sum(1), near)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        np.save(self._path, np.array(trace, float))


def read_trace(path: Path) -> Trace:
    """Return what a `TraceFile` wrote.

    Raises:
        OSError, EOFError, ValueError: If the file is damaged.
    """
    change, fingers, marked = np.load(path)
    return Trace(change, fingers.astype(int), marked.astype(bool))


def interventions(traces: Mapping[str, Trace], unit: str, shaded: str) -> bytes:
    """Draw the changes over one episode, fingers in contact behind.

    Args:
        traces: The same episode by method.
        unit: What `Trace.change` is.
        shaded: What `Trace.marked` is.
    """
    most = max(_MOST, *(int(trace.fingers.max(initial=0)) for trace in traces.values()))
    figure, panels = new_panels(9.0, 1.5 * len(traces) + 0.4, len(traces))
    for k, (axes, (name, trace)) in enumerate(zip(panels, traces.items(), strict=True)):
        time = _PERIOD * np.arange(len(trace.change))
        axes.plot(time, trace.change, color=colour(k), lw=1.5)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], trace.marked.astype(int), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            axes.axvspan(_PERIOD * begin, _PERIOD * end, color=INK, alpha=0.2, lw=0)
        contacts = axes.twinx()
        contacts.step(time, trace.fingers, color=INK, lw=0.8, where="post", alpha=0.7)
        contacts.set(ylim=(0, most + 0.3), yticks=range(0, most + 1, 2))
        contacts.set_ylabel("contacts", color=INK, fontsize=8)
        contacts.tick_params(colors=INK, labelsize=8)
        contacts.spines[:].set_visible(False)
        axes.set(ylabel=name, ylim=(0, None))
    panels[-1].set_xlabel(f"time [s]; colour: {unit}, grey line: fingers in contact, grey area: {shaded}")
    return png(figure)
