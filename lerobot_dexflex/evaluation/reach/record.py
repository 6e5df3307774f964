"""What is kept of an episode, and its one-line form on disk."""

import json
from collections import Counter
from collections.abc import Hashable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lerobot_dexflex.commands.loop import MAX_STEPS, Episode
from lerobot_dexflex.evaluation.reach.metrics import around_events, measure, relative_error
from lerobot_dexflex.hand.contacts import CONTACT_FORCE


@dataclass(frozen=True)
class Record:
    """Result of one episode of one method in one cell."""

    method: str
    cell: str
    episode: int
    """Index in the list of chains; it decides start, goals and corruption for every method alike."""
    seed: int
    """Seed of the chain."""
    chain: str
    """Digest of the chain: starts and goals may not change under a seed."""
    version: str
    """Digest of the method's code and weights; records of other versions are run again."""
    group: tuple[int, int]
    """First and one past the last episode that ran in the same batch."""
    steps: int
    dropped: bool
    metrics: dict[str, float | None]
    """As `Metrics`."""
    event_curve: tuple[float | None, ...] | None
    """Intervention averaged over removals at `EVENT_LAGS` from their start."""
    branches: dict[str, float] | None
    """Share of steps by branch of the chosen candidate, where the method chooses."""
    trace: dict[str, list[Any]] | None
    """Series of the episode, for the first few."""

    @property
    def job(self) -> Hashable:
        """What was run together with this."""
        return self.method, self.cell, self.group

    @property
    def interface(self) -> str:
        """The method, for titles."""
        return self.method

    @property
    def ending(self) -> str:
        """How the episode ended: `success`, `dropped` or `time out`."""
        if self.dropped:
            return "dropped"
        return "success" if self.metrics["progress"] == 1.0 else "time out"

    def line(self) -> str:
        """Return the record as one line of JSON."""
        return json.dumps(asdict(self)) + "\n"

    @classmethod
    def parse(cls, line: str) -> "Record":
        """Inverse of `line`.

        Raises:
            ValueError: If the line is torn or of another form.
        """
        fields: dict[str, Any] = json.loads(line)
        try:
            fields["group"] = tuple(fields["group"])
            if fields["event_curve"] is not None:
                fields["event_curve"] = tuple(fields["event_curve"])
            return cls(**fields)
        except (KeyError, TypeError) as error:
            raise ValueError(f"Not a record of an episode: {line[:80]!r}") from error


def make_record(
    episode: Episode,
    *,
    method: str,
    cell: str,
    index: int,
    chain: str,
    version: str,
    group: tuple[int, int],
    traced: bool,
    max_steps: int = MAX_STEPS,
) -> Record:
    """Reduce a finished episode to what is kept.

    Args:
        episode: From `run_chains`.
        method: Name of the method.
        cell: Name of the cell.
        index: Number of the episode.
        chain: Digest of its chain.
        version: Digest of the method.
        group: Episodes that ran together.
        traced: Whether to keep the series.
        max_steps: Time limit that it ran under [control steps].
    """
    change = relative_error(episode.executed, episode.draft)
    curve = around_events(change, episode.in_event)
    return Record(
        method=method,
        cell=cell,
        episode=index,
        seed=episode.chain.seed,
        chain=chain,
        version=version,
        group=group,
        steps=episode.steps,
        dropped=episode.dropped,
        metrics={k: _rounded(v) for k, v in measure(episode, max_steps)._asdict().items()},
        event_curve=None if curve is None else tuple(_rounded(v) for v in curve.tolist()),
        branches=_branches(episode),
        trace=_trace(episode, change) if traced else None,
    )


def _trace(episode: Episode, change: Any) -> dict[str, list[Any]]:
    return {
        "intervention": [_rounded(v) for v in change.tolist()],
        "in_event": episode.in_event.astype(int).tolist(),
        "contacts": (episode.loads > CONTACT_FORCE).sum(1).tolist(),
    }


def _branches(episode: Episode) -> dict[str, float] | None:
    found = Counter(row["branch"] for row in episode.explanations if "branch" in row)
    total = sum(found.values())
    return {name: round(count / total, 4) for name, count in sorted(found.items())} if total else None


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 5)
