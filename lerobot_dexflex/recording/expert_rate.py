"""Measure how often the operator solves its task on unseen initial states."""

import functools
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import expert_module, make_expert
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.recording.attempt import Attempt, run_attempt
from lerobot_dexflex.recording.schema import FPS
from lerobot_dexflex.runs.jobs import Job, run_missing
from lerobot_dexflex.runs.provenance import method_version
from lerobot_dexflex.runs.table import Row

METHOD, CONDITION = "expert", "clean"
COLUMNS = ("success", "steps", "seconds", "progress_final")


def expert_rate(
    hand: Hand,
    task: str,
    episodes: int,
    seed: int,
    workers: int,
    table: Path,
    run: Callable[[int], Attempt] | None = None,
    quiet: bool = False,
) -> pd.DataFrame:
    """Let the expert attempt `episodes` initial states without cameras; returns their rows.

    Args:
        hand: The hand that does it.
        task: Name in `TASKS`.
        episodes: Number of initial states.
        seed: Attempt k starts from environment seed `seed + k`, which also counts its row.
        workers: Worker processes; 0 runs here. The rows do not depend on it.
        table: CSV file that gets one row per attempt; attempts that are there do not run again.
        run: Runs attempt k; None runs the expert.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If the task has no expert, `episodes` is not positive or `seed` negative, or another
            process works in the folder.
        KeyboardInterrupt: After the running attempts were finished and stored.
    """
    make_expert(task)
    if episodes < 1:
        raise DexFlexError(f"`episodes` must be at least 1. Got {episodes}.")
    if seed < 0:
        raise DexFlexError(f"`seed` must not be negative. Got {seed}.")
    own = Method.parse("joint").modules
    modules = (__name__, run_attempt.__module__, TASKS[task].module, expert_module(task), *own)
    # The expert's noise is drawn from the first seed and k.
    version = method_version(modules, first_seed=seed, hand=hand.signature)
    jobs = [Job(METHOD, version.name, task, CONDITION, (seed + k,)) for k in range(episodes)]
    attempt = run or functools.partial(run_attempt, hand, task, seed, cameras=False)
    work = functools.partial(_run_job, attempt, seed)
    return run_missing(table, COLUMNS, jobs, [version], work, workers, quiet)


def _run_job(run: Callable[[int], Attempt], first: int, job: Job) -> list[Row]:
    attempt = run(job.seeds[0] - first)
    return [
        {
            "success": attempt.success,
            "steps": attempt.steps,
            "seconds": round(attempt.steps / FPS, 4),
            "progress_final": round(attempt.progress, 4),
        }
    ]
