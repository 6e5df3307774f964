"""What is kept of an episode: the columns of its row."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.evaluation.events import Flags, around, contact_events
from lerobot_dexflex.runs.table import Row

_EPSILON = 1e-6
"""Regularises the relative size of an intervention where the draft stands still [m]."""
COLUMNS = (
    *("success", "steps", "seconds", "progress", "progress_final", "drops", "holding", "nht"),
    *("intervention", "intervention_event", "intervention_calm", "change_event", "change_calm"),
)
"""What an episode leaves in the table; see `Outcome`."""


class Motion(NamedTuple):
    """How an interface changed a draft in one control step, palm frame. Shapes (batch, fingers, 3), [m]."""

    draft: NDArray[np.float64]
    """Where the fingertips should be after the step, from where they are measured."""
    selected: NDArray[np.float64]
    """Motion from there that the interface asked of the hand, beside any grip."""

    def row(self, index: int) -> "Motion":
        """Return one episode of the batch, shapes (fingers, 3)."""
        return Motion(*(part[index] for part in self))

    def magnitude(self) -> float:
        """Return ||selected - draft|| / (||draft|| + 1 um) of one episode's step."""
        difference = np.linalg.norm(self.selected - self.draft)
        return float(difference / (np.linalg.norm(self.draft) + _EPSILON))

    def change(self) -> float:
        """Return the mean ||selected - draft|| of the fingertips in one episode's step [mm]."""
        return float(1e3 * np.linalg.norm(self.selected - self.draft, axis=-1).mean())


class Ended(Protocol):
    """What a film or recording tells of an episode that has ended."""

    @property
    def interface(self) -> str:
        """Who acted."""
        ...

    @property
    def episode(self) -> int:
        """Number of the episode."""
        ...

    @property
    def steps(self) -> int:
        """Control steps run."""
        ...

    @property
    def ending(self) -> str:
        """How it ended: `success`, `dropped` or `time out`."""
        ...


@dataclass(frozen=True)
class Outcome:
    """Result of one episode under one interface."""

    interface: str
    episode: int
    """Its seed."""
    success: bool
    steps: int
    """Control steps until it ended."""
    seconds: float
    """Simulated time of these steps [s]."""
    progress: float
    """The largest of the episode, in [0, 1]."""
    progress_final: float
    """The last one."""
    drops: int | None
    """How often the object was dropped; None if the task does not report it."""
    holding: float | None
    """Fraction of steps with the object held; None if the task does not report it."""
    nht: float | None
    """Normalised holding time (paper, section 4.1): fraction of the steps from the first grasp to success
    or time limit with the object held; 0 without a grasp, None if the task does not report it."""
    intervention: float | None
    """Mean relative size of the interface's changes to the draft; None where there is no draft."""
    intervention_event: float | None
    """The mean around contact events, see `events.around`; None without a draft or any event."""
    intervention_calm: float | None
    """The mean over all other steps with the object in hand; None without a draft or any such step."""
    change_event: float | None
    """The same of how far the fingertips are sent elsewhere [mm]: it does not grow where the draft rests."""
    change_calm: float | None

    @property
    def ending(self) -> str:
        """How the episode ended; see `ending_of`."""
        return ending_of(self.success, self.drops)

    def row(self) -> Row:
        """Return its values by column."""
        return {name: getattr(self, name) for name in COLUMNS}


def ending_of(success: bool, drops: float | None) -> str:
    """Return how an episode ended: `success`, `dropped` or `time out`.

    Args:
        success: Whether it succeeded.
        drops: Number of drops; None or NaN if unknown.
    """
    if success:
        return "success"
    return "dropped" if drops is not None and drops > 0 else "time out"


class Recorder:
    """Collects the infos of a running episode.

    Args:
        info: Info of the reset.
        period: Control period [s].
        limit: Time limit in control steps.
    """

    def __init__(self, info: dict[str, Any], period: float, limit: int) -> None:
        self.success = bool(info["is_success"])
        self.steps = 0
        self._period, self._limit = period, limit
        self._progress = [float(info["progress"])]
        self._drops = 0 if "dropped" in info else None
        self._was_dropped = bool(info.get("dropped", False))
        self._held: list[bool] | None = [] if "holding" in info else None
        self._contacts = [info["contacts"]] if "contacts" in info else None
        self._motions: list[Motion | None] = []

    def add(self, info: dict[str, Any], motion: Motion | None) -> None:
        """Add a control step."""
        self.steps += 1
        self.success |= bool(info["is_success"])
        self._progress.append(float(info["progress"]))
        if self._drops is not None:
            self._drops += bool(info["dropped"]) and not self._was_dropped
            self._was_dropped = bool(info["dropped"])
        if self._held is not None:
            self._held.append(bool(info["holding"]))
        if self._contacts is not None:
            self._contacts.append(info["contacts"])
        self._motions.append(motion)

    def outcome(self, interface: str, episode: int) -> Outcome:
        """Return the result of the finished episode, rounded to what is worth keeping."""
        sizes = _each(Motion.magnitude, self._motions)
        changes = _each(Motion.change, self._motions)
        event, calm = self._when()
        return Outcome(
            interface=interface,
            episode=episode,
            success=self.success,
            steps=self.steps,
            seconds=round(self.steps * self._period, 4),
            progress=round(max(self._progress), 4),
            progress_final=round(self._progress[-1], 4),
            drops=self._drops,
            holding=None if self._held is None else round(sum(self._held) / max(self.steps, 1), 4),
            nht=self._nht(),
            intervention=_mean(sizes),
            intervention_event=_mean(sizes, event),
            intervention_calm=_mean(sizes, calm),
            change_event=_mean(changes, event),
            change_calm=_mean(changes, calm),
        )

    def _nht(self) -> float | None:
        if self._held is None:
            return None
        if True not in self._held:
            return 0.0
        end = self.steps if self.success else self._limit
        return round(sum(self._held) / (end - self._held.index(True)), 4)

    def _when(self) -> tuple[Flags, Flags]:
        """Return which steps are around contact events, and which others have the object in hand."""
        if self._contacts is None or self._held is None:
            return np.zeros(self.steps, bool), np.zeros(self.steps, bool)
        near = around(contact_events(np.array(self._contacts)))
        return near, ~near & np.array(self._held, bool)


def _each(measure: Callable[[Motion], float], motions: Sequence[Motion | None]) -> NDArray[np.float64]:
    return np.array([np.nan if motion is None else measure(motion) for motion in motions])


def _mean(values: NDArray[np.float64], steps: Flags | None = None) -> float | None:
    """Return the mean over all or some steps with a motion; None where there is none."""
    chosen = values if steps is None else values[steps]
    chosen = chosen[np.isfinite(chosen)]
    return round(float(chosen.mean()), 4) if chosen.size else None
