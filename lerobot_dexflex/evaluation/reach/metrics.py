"""What one episode is worth, from its series; everything is computed once, after the episode."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.commands.loop import MAX_STEPS, Episode
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.hand.contacts import CONTACT_FORCE

Array = NDArray[np.float64]

EPSILON = 0.002
"""Regularises relative errors where a motion stands still [m]; as large as a median clean motion."""
TIGHT_BUDGET = 1.25
"""The tight time budget of a chain, over the steps that the operator took itself."""
EVENT_BIN = 4
EVENT_LAGS = np.arange(-8, 24, EVENT_BIN)
"""Control steps from the first step of an event at which bins of `EVENT_BIN` steps begin; interventions are
averaged in each."""


class Metrics(NamedTuple):
    """Numbers of one episode; u* = clean motion, ũ = draft, û = selected, each (steps, fingers, 3) [m]."""

    duration: float
    """Share of the time limit until the object was dropped; 1 if it never was."""
    progress: float
    """Goals reached plus partial credit, over all goals, within the full time limit."""
    progress_budget: float
    """The same within `TIGHT_BUDGET`, at most the full limit: standing still costs something."""
    goal_steps: float | None
    """Mean control steps of the goals that were reached; None without any. Easy goals are reached by all, so
    that only methods that reach about as many may be compared."""
    intent: float
    """Intent error ||û - u*|| / (||u*|| + 2 mm), completed: after a drop every step counts 1. An average over
    the living steps alone would reward dropping early."""
    intent_loaded: float | None
    """The same over the fingers that carry load before the step, completed too; None if none ever does."""
    intent_free: float | None
    """Over the fingers that carry none."""
    intent_event: float | None
    """The error over the steps of events (removal, freeze, dropout), not completed; None without any."""
    intent_calm: float | None
    """Over all other steps of an episode with events."""
    intervention: float
    """||û - ũ|| / (||ũ|| + 2 mm) over the steps that were run."""
    intervention_event: float | None
    intervention_calm: float | None
    retention: float | None
    """Share of loaded fingers that still carry load 8 steps later; a drop loses all. Fingers that are lifted
    on purpose count as lost, for all methods alike, so the operator does not reach 1."""


def relative_error(first: Array, second: Array, fingers: NDArray[np.bool_] | None = None) -> Array:
    """Return ||first - second|| / (||second|| + EPSILON) per step, over the fingertips. Shape (T,).

    Args:
        first: Motions [m]. Shape (T, fingers, 3).
        second: What they are compared with [m]. Shape (T, fingers, 3).
        fingers: Which fingertips count; all if None. Shape (T, fingers).
    """
    counted = np.ones((*first.shape[:2], 1)) if fingers is None else fingers[..., None]
    size = np.linalg.norm((second * counted).reshape(len(second), -1), axis=1)
    return np.linalg.norm(((first - second) * counted).reshape(len(first), -1), axis=1) / (size + EPSILON)


def measure(episode: Episode, max_steps: int = MAX_STEPS) -> Metrics:
    """Return the metrics of a finished episode.

    Args:
        episode: From `run_chains`.
        max_steps: Time limit that it ran under [control steps].
    """
    duration = min(1.0, episode.steps / max_steps) if episode.dropped else 1.0
    intent = relative_error(episode.selected, episode.label)
    change = relative_error(episode.selected, episode.draft)
    event, loaded = episode.in_event.astype(bool), episode.loads > CONTACT_FORCE
    return Metrics(
        duration=duration,
        progress=episode.progress,
        progress_budget=_progress_at(episode, min(max_steps, tight_budget(episode.chain.steps))),
        goal_steps=_mean(np.array(episode.goal_steps, float)),
        intent=float(intent.mean()) * duration + (1.0 - duration),
        intent_loaded=_intent_of(episode, loaded, duration),
        intent_free=_intent_of(episode, ~loaded, duration),
        intent_event=_mean(intent[event]),
        intent_calm=_mean(intent[~event]) if event.any() else None,
        intervention=float(change.mean()),
        intervention_event=_mean(change[event]),
        intervention_calm=_mean(change[~event]) if event.any() else None,
        retention=contact_retention(episode.loads, episode.dropped),
    )


def tight_budget(operator_steps: int) -> int:
    """Return the tight time budget of a chain that took the operator so many control steps."""
    return math.ceil(TIGHT_BUDGET * operator_steps)


def _progress_at(episode: Episode, budget: int) -> float:
    """Return the progress after so many steps; that of the end if there were fewer."""
    return float(episode.progress_at[min(budget, episode.steps) - 1])


def _intent_of(episode: Episode, fingers: NDArray[np.bool_], duration: float) -> float | None:
    error = relative_error(episode.selected, episode.label, fingers)
    alive = _mean(error[fingers.any(1)])
    return None if alive is None else alive * duration + (1.0 - duration)


def contact_retention(loads: Array, dropped: bool, horizon: int = DRAFT_HORIZON) -> float | None:
    """Return the share of loaded fingers that carry load `horizon` steps later; None if there are none.

    Args:
        loads: Normal force of each fingertip before each step [N]. Shape (T, fingers).
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
    """Return the mean of a series in bins around events, as `EVENT_LAGS`; None without events.

    Steps before the episode or after its end are left out; bins in which no event has a step are NaN.

    Args:
        series: One value per step. Shape (T,).
        in_event: Whether an event is going on. Shape (T,).
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
