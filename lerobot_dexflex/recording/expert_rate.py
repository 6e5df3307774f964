"""Measure how often the scripted expert solves its task on unseen initial states."""

import contextlib
import functools
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tqdm import tqdm

from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import expert_module, make_expert
from lerobot_dexflex.recording.attempt import Attempt, run_attempt
from lerobot_dexflex.runs.provenance import code_digest, provenance
from lerobot_dexflex.runs.statistics import Rate, success_rate
from lerobot_dexflex.runs.workers import run_each


def expert_rate(
    task: str,
    episodes: int,
    seed: int,
    workers: int,
    output: Path,
    run: Callable[[int], Attempt] | None = None,
) -> Rate:
    """Let the expert attempt `episodes` initial states without cameras; write all outcomes to `output`.

    The file is written after each attempt: an interrupted measurement continues, a larger `episodes`
    extends it.

    Args:
        task: Name in `TASKS`.
        episodes: Number of initial states.
        seed: Attempt k starts from environment seed `seed + k`.
        workers: Worker processes; 0 runs here. The outcomes do not depend on it.
        output: JSON file.
        run: Runs one attempt; None runs the expert.

    Raises:
        DexFlexError: If the task has no expert, `episodes` is not positive, or `output` holds anything but
            an unfinished or smaller measurement of the same task, seed and code.
    """
    make_expert(task)
    if episodes < 1:
        raise DexFlexError(f"`episodes` must be at least 1. Got {episodes}.")
    modules = (run_attempt.__module__, TASKS[task].module, expert_module(task))
    identity = {"task": task, "seed": seed, "code": code_digest(modules)}
    done = _finished(output, identity)
    missing = [index for index in range(episodes) if index not in done]
    numbers = iter(missing)
    origin = provenance("python", modules, sys.argv)
    output.parent.mkdir(parents=True, exist_ok=True)
    run = run or functools.partial(run_attempt, task, seed, cameras=False)
    with (
        tqdm(total=len(done) + len(missing), initial=len(done), unit="episode", desc=f"Expert {task}") as bar,
        contextlib.closing(run_each(run, lambda running: next(numbers, None), workers)) as results,
    ):
        for attempt in results:
            done[attempt.index] = attempt.summary()
            _write(output, identity, origin, done)
            bar.update()
            bar.set_postfix_str(f"{sum(a['success'] for a in done.values())}/{len(done)} succeeded")
    return _rate(done)


def _rate(done: dict[int, dict[str, Any]]) -> Rate:
    return success_rate([attempt["success"] for attempt in done.values()])


def _finished(output: Path, identity: dict[str, Any]) -> dict[int, dict[str, Any]]:
    if not output.exists():
        return {}
    try:
        found = json.loads(output.read_text())
        attempts = {attempt["attempt"]: attempt for attempt in found["attempts"]}
        stored = {key: found[key] for key in identity}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DexFlexError(
            f"{output} exists and is no measurement of the expert. Choose another --output; nothing was "
            "changed."
        ) from error
    if stored != identity:
        raise DexFlexError(
            f"{output} was measured with {stored}, now {identity}. Choose another --output, or delete it."
        )
    return attempts


def _write(
    output: Path, identity: dict[str, Any], origin: dict[str, Any], done: dict[int, dict[str, Any]]
) -> None:
    value = {**origin, **identity, **_rate(done)._asdict(), "attempts": [done[k] for k in sorted(done)]}
    temporary = output.with_name(f".{output.name}.{os.getpid()}")
    temporary.write_text(json.dumps(value, indent=1) + "\n")
    temporary.replace(output)
