"""Judge a task by stages; what must be remembered goes into `HandEnv.memory`, which snapshots carry."""

from collections.abc import Sequence
from typing import Any

import numpy as np

SETTLED_STEPS = 10
"""Control steps for which a task must look solved to be solved: half a second."""


def has_settled(memory: dict[str, Any], solved: bool | np.bool) -> bool:
    """Count for how many control steps in a row `solved` has been true; true from `SETTLED_STEPS` on."""
    memory["settled"] = memory.get("settled", 0) + 1 if solved else 0
    return memory["settled"] >= SETTLED_STEPS


def furthest_progress(memory: dict[str, Any], stages: Sequence[bool | np.bool]) -> float:
    """Return the furthest stage of the episode so far as a share of all stages; it never falls.

    Args:
        memory: `HandEnv.memory`.
        stages: Whether each stage holds now, in their order; one that holds counts those before it as done.
    """
    reached = max([k + 1 for k, stage in enumerate(stages) if stage], default=0)
    memory["stage"] = max(memory.get("stage", 0), reached)
    return memory["stage"] / len(stages)
