"""Record demonstrations: attempts in parallel, each atomic, the dataset in one deterministic order."""

import contextlib
import dataclasses
import functools
import shutil
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from tqdm import tqdm

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.recording.attempt import Attempt, run_attempt, save_attempt
from lerobot_dexflex.recording.config import RecordConfig
from lerobot_dexflex.recording.staging import is_complete, open_staging, staged_attempts, staging_folder
from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.provenance import provenance
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
    try:
        if not is_complete(config):
            with locked(config.root):
                if not is_complete(config):  # Another process may have finished it in between.
                    return _record(config, arguments)
    except OSError as error:
        raise DexFlexError(
            f"Recording stopped: {error}. Finished attempts are kept in {staging_folder(config.root)}. "
            "Is the disk full? Free some space, then run the same command again to continue."
        ) from error
    print(f"{config.root} is complete: {config.episodes} episodes of this recipe. Nothing to record.")
    return True


def _record(config: RecordConfig, arguments: list[str] | None) -> bool:
    origin = provenance("dexflex-record", config.modules, arguments) | {
        "controller": config.controller_digest
    }
    staging = open_staging(config)
    known = staged_attempts(staging)
    attempts, interrupted = _collect(config, staging, known)
    if any(attempt.success for attempt in attempts):
        _assemble(config, staging, attempts, origin)
    successes = sum(attempt.success for attempt in attempts)
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
    with _one_thread():
        attempt = run_attempt(
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


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Let networks add up in one order: more threads change last bits, and contacts make them visible."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _assemble(config: RecordConfig, staging: Path, attempts: list[Attempt], origin: dict[str, Any]) -> None:
    # LeRobot takes seconds to import; workers and error messages need not wait for it.
    from lerobot_dexflex.recording.dataset import assemble

    def progress(episodes: Iterable[Attempt]) -> Iterable[Attempt]:
        return tqdm(episodes, unit="episode", desc="Writing dataset")

    with _interrupt_deferred():
        assemble(config, staging, attempts, origin, progress)
    if sum(attempt.success for attempt in attempts) == config.episodes:
        shutil.rmtree(staging)


@contextlib.contextmanager
def _interrupt_deferred() -> Iterator[None]:
    """Answer the first Ctrl-C with a note; a second one interrupts as usual."""

    def note(number: int, frame: FrameType | None) -> None:
        del number, frame
        print("\nWriting the dataset first. Press Ctrl-C again to stop at once (attempts are kept).")
        signal.signal(signal.SIGINT, previous)

    previous: Callable | int | None = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
