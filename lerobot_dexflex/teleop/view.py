"""What the operator, or whoever looks later, sees: a rerun recording per episode."""

from pathlib import Path
from typing import Any, NamedTuple, Protocol

import gymnasium

from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.evaluation.report.rerun_log import RerunLog


class View(Protocol):
    """Looks on."""

    def begin(self, index: int, recorded: bool) -> None:
        """A run begins: attempt `index`, or practice before it."""
        ...

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """See a control step."""
        ...

    def end(self, ending: str, steps: int) -> None:
        """A run has ended, for a reason, after so many control steps."""
        ...


class NoView:
    """Sees nothing. Satisfies `View`."""

    def begin(self, index: int, recorded: bool) -> None:
        """See `View.begin`."""

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """See `View.watch`."""

    def end(self, ending: str, steps: int) -> None:
        """See `View.end`."""


class Ending(NamedTuple):
    """How a run ended. Satisfies `Ended`."""

    interface: str
    episode: int
    steps: int
    ending: str


class RerunView:
    """Images, touch, fingertips and drafts, in rerun's viewer or in files. Satisfies `View`.

    Args:
        interface: Name of the method, root of the entities.
        folder: Where a file per attempt goes; None shows everything, practice too, in the viewer.
    """

    def __init__(self, interface: str, folder: Path | None) -> None:
        self._interface, self._folder = interface, folder
        self._log: RerunLog | None = None
        self._index = self._runs = 0

    def begin(self, index: int, recorded: bool) -> None:
        """See `View.begin`."""
        self.end("practice", 0)
        self._index, self._runs = index, self._runs + 1
        if self._folder is None:
            self._log = RerunLog(None, self._interface, self._runs)
        elif recorded:
            self._log = RerunLog(self._folder / f"attempt_{index:06d}.rrd", self._interface, index)

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """See `View.watch`."""
        if self._log is not None:
            self._log.watch(env, observation, info, motion)

    def end(self, ending: str, steps: int) -> None:
        """See `View.end`."""
        if self._log is not None:
            self._log.close(Ending(self._interface, self._index, steps, ending))
        self._log = None


def make_view(interface: str, folder: Path | None, beside: Path) -> RerunView:
    """Return the viewer, or, where there is no display, files.

    Args:
        interface: Name of the method.
        folder: Where files go even if there is a display.
        beside: The dataset, beside which they go else.
    """
    from lerobot.utils.keyboard_input import is_headless

    if folder is None and is_headless():
        folder = beside.with_name(f"{beside.name}.rerun")
        print(f"There is no display: recordings for rerun go to {folder}.")
    return RerunView(interface, folder)
