"""Record demonstrations: attempts in parallel, each atomic, the dataset in one deterministic order."""

import contextlib
import dataclasses
import functools
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from tqdm import tqdm

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.recording.assembly import disk_errors, origin_of, write_dataset
from lerobot_dexflex.recording.attempt import Attempt, one_thread, run_attempt, save_attempt
from lerobot_dexflex.recording.config import RecordConfig
from lerobot_dexflex.recording.staging import is_complete, open_staging, staged_attempts
from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.workers import run_each


def record(config: RecordConfig, arguments: list[str] | None = None) -> bool:
    """Record `config.episodes` successful demonstrations, or continue an interrupted recording.

    Which attempts are kept depends on the recipe alone: attempts count up from 0 until enough succeeded,
    whatever the number of workers and interruptions. An interrupt leaves the finished episodes as a
    loadable dataset.

    Args:
        config: The recipe.
        arguments: Command-line arguments for the card; None takes those of this process.

    Returns:
        Whether the dataset is complete; False after an interrupt.

    Raises:
        DexFlexError: If the output folder holds something else or another process records there, the task
            has no expert, the expert fails too often, or the disk is full. Finished episodes are never lost.
    """
    make_expert(config.task)
    with disk_errors(config):
        if not is_complete(config):
            with locked(config.root):
                if not is_complete(config):  # Another process may have finished it in between.
                    return _record(config, arguments)
    print(f"{config.root} is complete: {config.episodes} episodes of this recipe. Nothing to record.")
    return True


def _record(config: RecordConfig, arguments: list[str] | None) -> bool:
    origin, staging = origin_of(config, arguments), open_staging(config)
    attempts, interrupted = _collect(config, staging, staged_attempts(staging))
    successes = write_dataset(config, staging, attempts, origin)
    if interrupted:
        print(f"Interrupted: {successes} of {config.episodes} episodes are loadable from {config.root}.")
        print("Run the same command again to continue.")
        return False
    if successes < config.episodes:
        raise DexFlexError(
            f"The expert succeeded only {successes} times in {len(attempts)} attempts, {config.episodes} "
            f"episodes were asked for. The {successes} episodes are kept; raise --max_attempts to continue."
        )
    print(f"Recorded {successes} episodes ({len(attempts)} attempts) to {config.root}.")
    return True


def _collect(config: RecordConfig, staging: Path, known: dict[int, Attempt]) -> tuple[list[Attempt], bool]:
    """Run the attempts that are missing; return all in order, and whether the user stopped it."""
    function = functools.partial(_record_attempt, config, str(staging))
    done: dict[int, Attempt] = {}
    interrupted = False
    started = 0

    with tqdm(total=config.episodes, unit="episode", desc=f"Recording {config.task}") as bar:

        def account(attempt: Attempt) -> None:
            done[attempt.index] = attempt
            bar.update(attempt.success)
            bar.set_postfix_str(f"{sum(a.success for a in done.values())}/{len(done)} attempts succeeded")

        def next_number(running: int) -> int | None:
            nonlocal started
            # Starting only what is certainly needed makes the last attempt independent of the timing.
            while sum(a.success for a in done.values()) + running < config.episodes:
                if started == config.attempt_limit:
                    return None
                started += 1
                if started - 1 not in known:
                    return started - 1
                account(known[started - 1])
            return None

        try:
            with contextlib.closing(run_each(function, next_number, config.workers)) as results:
                for attempt in results:
                    account(attempt)
        except KeyboardInterrupt:
            interrupted = True
        except BrokenProcessPool as error:
            raise DexFlexError(
                "A worker process died (out of memory?). Finished episodes are kept: run the same command "
                "again, with --workers=1 if it dies again."
            ) from error
    if interrupted:
        done = staged_attempts(staging)
    return [done[index] for index in sorted(done)], interrupted


def _record_attempt(config: RecordConfig, staging: str, index: int) -> Attempt:
    with one_thread():
        attempt = run_attempt(
            get_hand(config.hand),
            config.task,
            config.seed,
            index,
            interface=config.interface,
            glove=config.glove,
            source=config.source,
            controller=config.controller,
        )
    save_attempt(attempt, Path(staging))
    return dataclasses.replace(attempt, frames={})
