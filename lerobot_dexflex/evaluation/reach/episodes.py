"""Run the episodes of a job and keep of each a row of numbers.

What this imports decides the episodes and their version: nothing of the engine belongs here.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from lerobot_dexflex.commands.loop import MAX_STEPS, Episode, run_chains
from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.reach.metrics import Metrics, around_events, measure, relative_error
from lerobot_dexflex.experts.reach.chains import Chain
from lerobot_dexflex.interfaces.protocol import Interface

BRANCHES = ("draft", "pure", "seeded", "finger")
"""Kinds of candidates that a method may choose among; each has a column, the share of its steps."""
COLUMNS = ("chain", "steps", "dropped", *Metrics._fields, "around", *BRANCHES)
"""Of the benchmark's rows. `chain` is a digest of start and goals, `around` the intervention around events:
its mean in each of `EVENT_LAGS`, words of one text."""


def run_episodes(
    chains: Sequence[Chain], condition: str, interface: Interface, batch: int
) -> list[dict[str, Any]]:
    """Run one episode per chain.

    Args:
        chains: Starts and goals.
        condition: Name of what goes wrong and who commands.
        interface: The method under test.
        batch: Hands that are simulated side by side.

    Returns:
        `COLUMNS` of each episode, in the order of the chains.
    """
    parsed = Condition.parse(condition)
    episodes = run_chains(chains, parsed.errors, interface, source=parsed.source, batch=batch)
    return [episode_row(episode) for episode in episodes]


def episode_row(episode: Episode, max_steps: int = MAX_STEPS) -> dict[str, Any]:
    """Reduce a finished episode to its row.

    Args:
        episode: From `run_chains`.
        max_steps: Time limit that it ran under [control steps].
    """
    change = relative_error(episode.selected, episode.draft)
    around = around_events(change, episode.in_event)
    return {
        "chain": chain_digest(episode.chain),
        "steps": episode.steps,
        "dropped": bool(episode.dropped),
        **{name: _rounded(value) for name, value in measure(episode, max_steps)._asdict().items()},
        "around": None if around is None else " ".join(f"{value:.2f}" for value in around),
        **_branches(episode),
    }


def chain_digest(chain: Chain) -> str:
    """Return a short digest of start and goals."""
    return hashlib.sha256(json.dumps(chain.to_json(), sort_keys=True).encode()).hexdigest()[:8]


def _branches(episode: Episode) -> dict[str, float | None]:
    found = Counter(row["branch"] for row in episode.explanations if "branch" in row)
    total = found.total()
    return {name: round(found[name] / total, 4) if total else None for name in BRANCHES}


def _rounded(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 4)
