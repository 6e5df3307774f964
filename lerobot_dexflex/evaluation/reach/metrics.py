"""What one episode is worth, from its series; everything is computed once, after the episode."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.commands.loop import MAX_STEPS, Episode
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.hand.contacts import CONTACT_FORCE

Array = NDArray[np.float64]

EPSILON = 0.002
"""Regularises relative errors where a command stands still [m]; as large as a median clean command."""
EVENT_BIN = 4
EVENT_LAGS = np.arange(-8, 24, EVENT_BIN)
"""Control steps from the first step of a removal at which bins of `EVENT_BIN` steps begin; interventions are
averaged in each."""


class Metrics(NamedTuple):
    """Numbers of one episode; u* = clean command, ũ = draft, û = executed, each (steps, 4, 3) [m]."""

    duration: float
    """Share of the time limit until the object was dropped; 1 if it never was."""
    progress: float
    """Goals reached plus partial credit, over all goals."""
    intent: float
    """Intent error ||û - u*|| / (||u*|| + 2 mm), completed: after a drop every step counts 1. An average over
    the living steps alone would reward dropping early."""
    intent_event: float | None
    """The error over the steps of removals; None without any."""
    intent_calm: float | None
    """Over all other steps of an episode with removals."""
    intervention: float
    """||û - ũ|| / (||ũ|| + 2 mm) over the steps that were run."""
    intervention_event: float | None
    intervention_calm: float | None
    retention: float | None
    """Share of loaded fingers that still carry load 8 steps later; a drop loses all. Fingers that are lifted
    on purpose count as lost, for all methods alike, so the clean operator does not reach 1."""


def relative_error(first: Array, second: Array) -> Array:
    """Return ||first - second|| / (||second|| + EPSILON) per step, over all four fingertips. Shape (T,)."""
    size = np.linalg.norm(second.reshape(len(second), -1), axis=1)
    return np.linalg.norm((first - second).reshape(len(first), -1), axis=1) / (size + EPSILON)


def measure(episode: Episode, max_steps: int = MAX_STEPS) -> Metrics:
    """Return the metrics of a finished episode.

    Args:
        episode: From `run_chains`.
        max_steps: Time limit that it ran under [control steps].
    """
    duration = min(1.0, episode.steps / max_steps) if episode.dropped else 1.0
    intent = relative_error(episode.executed, episode.label)
    change = relative_error(episode.executed, episode.draft)
    event = episode.in_event.astype(bool)
    alive = float(intent.mean())
    return Metrics(
        duration=duration,
        progress=episode.progress,
        intent=alive * duration + (1.0 - duration),
        intent_event=_mean(intent[event]),
        intent_calm=_mean(intent[~event]) if event.any() else None,
        intervention=float(change.mean()),
        intervention_event=_mean(change[event]),
        intervention_calm=_mean(change[~event]) if event.any() else None,
        retention=contact_retention(episode.loads, episode.dropped),
    )


def contact_retention(loads: Array, dropped: bool, horizon: int = DRAFT_HORIZON) -> float | None:
    """Return the share of loaded fingers that carry load `horizon` steps later; None if there are none.

    Args:
        loads: Normal force of each fingertip before each step [N]. Shape (T, 4).
        dropped: Whether the object was lost at the end; then no finger carries load afterwards. Otherwise the
            last `horizon` steps have no answer.
        horizon: How much later [control steps].
    """
    loaded = loads > CONTACT_FORCE
    later = loaded[horizon:]
    if dropped:
        later = np.concatenate([later, np.zeros((min(horizon, len(loaded)), loads.shape[1]), bool)])
    now = loaded[: len(later)]
    return float((now & later).sum() / now.sum()) if now.any() else None


def around_events(series: Array, in_event: NDArray[np.bool_]) -> Array | None:
    """Return the mean of a series in bins around removals, as `EVENT_LAGS`; None without removals.

    Steps before the episode or after its end are left out; bins in which no removal has a step are NaN.

    Args:
        series: One value per step. Shape (T,).
        in_event: Whether a removal is going on. Shape (T,).
    """
    began = np.flatnonzero(in_event & ~np.concatenate([[False], in_event[:-1]]))
    if not len(began):
        return None
    at = EVENT_LAGS[:, None, None] + began[:, None] + np.arange(EVENT_BIN)  # (bins, events, steps)
    inside = (at >= 0) & (at < len(series))
    values = np.where(inside, series[np.clip(at, 0, len(series) - 1)], 0.0)
    count = inside.sum((1, 2))
    return np.where(count > 0, values.sum((1, 2)) / np.maximum(count, 1), np.nan)


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None
