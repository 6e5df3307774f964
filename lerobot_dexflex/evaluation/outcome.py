"""What is kept of an episode, and its one-line form on disk."""

import json
from collections.abc import Hashable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

_EPSILON = 1e-6
"""Regularises the relative size of an intervention where the draft stands still [m]."""


class Motion(NamedTuple):
    """How an interface changed a draft in one control step, palm frame. Shapes (batch, 4, 3), [m]."""

    draft: NDArray[np.float64]
    """Displacement of the commanded fingertips that the policy asked for."""
    executed: NDArray[np.float64]
    """Displacement that the interface executed."""
    command: NDArray[np.float64]
    """Commanded fingertips after the step."""

    def row(self, index: int) -> "Motion":
        """Return one episode of the batch, shapes (4, 3)."""
        return Motion(*(part[index] for part in self))

    def magnitude(self) -> float:
        """Return ||executed - draft|| / (||draft|| + 1 um) of one episode's step."""
        difference = np.linalg.norm(self.executed - self.draft)
        return float(difference / (np.linalg.norm(self.draft) + _EPSILON))


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
    """Index in the comparison; the same index is the same initial state under every interface."""
    seed: int
    group: tuple[int, int]
    """First and one past the last episode that ran in the same batch."""
    success: bool
    steps: int
    completion_time: float | None
    """Time to success [s]; None without success."""
    progress_max: float
    progress_final: float
    progress: tuple[tuple[int, float], ...]
    """(step, progress) at the start and wherever progress changed."""
    drops: int | None
    """How often the object was dropped; None if the task does not report it."""
    holding: float | None
    """Fraction of steps with the object held; None if the task does not report it."""
    intervention: float | None
    """Mean relative size of the interface's changes to the draft; None where there is no draft."""

    def line(self) -> str:
        """Return the outcome as one line of JSON."""
        return json.dumps(asdict(self)) + "\n"

    @classmethod
    def parse(cls, line: str) -> "Outcome":
        """Inverse of `line`.

        Raises:
            ValueError: If the line is torn or of another form.
        """
        fields: dict[str, Any] = json.loads(line)
        try:
            fields["group"] = tuple(fields["group"])
            fields["progress"] = tuple((step, value) for step, value in fields["progress"])
            return cls(**fields)
        except (KeyError, TypeError) as error:
            raise ValueError(f"Not an outcome: {line[:80]!r}") from error

    @property
    def job(self) -> Hashable:
        """What was run together with this episode."""
        return self.interface, self.group

    @property
    def ending(self) -> str:
        """How the episode ended: `success`, `dropped` or `time out`."""
        if self.success:
            return "success"
        return "dropped" if self.drops else "time out"

    def progress_at(self, steps: Sequence[int] | NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the progress at control steps; the last value holds after the end. Shape (len(steps),)."""
        at, values = np.array([point[0] for point in self.progress]), [point[1] for point in self.progress]
        return np.asarray(values)[np.searchsorted(at, steps, side="right") - 1]


class Recorder:
    """Collects the infos of a running episode.

    Args:
        info: Info of the reset.
        period: Control period [s].
    """

    def __init__(self, info: dict[str, Any], period: float) -> None:
        self.success = bool(info["is_success"])
        self.steps = 0
        self._period = period
        self._progress = [(0, _rounded(info["progress"]))]
        self._drops = 0 if "dropped" in info else None
        self._was_dropped = bool(info.get("dropped", False))
        self._held = 0 if "holding" in info else None
        self._magnitudes: list[float] = []

    def add(self, info: dict[str, Any], motion: Motion | None) -> None:
        """Add a control step."""
        self.steps += 1
        self.success |= bool(info["is_success"])
        value = _rounded(info["progress"])
        if value != self._progress[-1][1]:
            self._progress.append((self.steps, value))
        if self._drops is not None:
            self._drops += bool(info["dropped"]) and not self._was_dropped
            self._was_dropped = bool(info["dropped"])
        if self._held is not None:
            self._held += bool(info["holding"])
        if motion is not None:
            self._magnitudes.append(motion.magnitude())

    def outcome(self, interface: str, episode: int, seed: int, group: tuple[int, int]) -> Outcome:
        """Return the result of the finished episode."""
        values = [value for _, value in self._progress]
        return Outcome(
            interface=interface,
            episode=episode,
            seed=seed,
            group=group,
            success=self.success,
            steps=self.steps,
            completion_time=round(self.steps * self._period, 6) if self.success else None,
            progress_max=max(values),
            progress_final=values[-1],
            progress=tuple(self._progress),
            drops=self._drops,
            holding=None if self._held is None else round(self._held / max(self.steps, 1), 6),
            intervention=round(float(np.mean(self._magnitudes)), 6) if self._magnitudes else None,
        )


def _rounded(progress: float) -> float:
    return round(float(progress), 4)
