"""From finished attempts to a dataset, without losing one to Ctrl-C or a full disk."""

import contextlib
import shutil
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from tqdm import tqdm

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.attempt import Attempt
from lerobot_dexflex.recording.recipe import Recipe
from lerobot_dexflex.recording.staging import staging_folder
from lerobot_dexflex.runs.provenance import provenance


def origin_of(config: Recipe, arguments: list[str] | None) -> dict[str, Any]:
    """Return where episodes come from, for cards; ask before the first, while the code is what runs.

    Args:
        config: The recipe.
        arguments: Command-line arguments; None takes those of this process.
    """
    found = provenance(config.program, config.modules, arguments)
    return found | {"program": config.program, "controller": config.controller_digest}


def write_dataset(config: Recipe, staging: Path, attempts: Sequence[Attempt], origin: dict[str, Any]) -> int:
    """Write the attempts that are kept, if any, to the dataset; one that is complete needs no staging more.

    Args:
        config: The recipe.
        staging: Folder of the attempts' files.
        attempts: All finished attempts, in order.
        origin: Of the recording.

    Returns:
        Number of episodes.

    Raises:
        DexFlexError: If an attempt's file is damaged or the dataset could not be written; none is lost.
    """
    kept = sum(attempt.kept for attempt in attempts)
    if not kept:
        return 0
    # LeRobot takes seconds to import; workers and error messages need not wait for it.
    from lerobot_dexflex.recording.dataset import assemble

    def progress(episodes: Iterable[Attempt]) -> Iterable[Attempt]:
        return tqdm(episodes, unit="episode", desc="Writing dataset")

    with _interrupt_deferred():
        assemble(config, staging, attempts, origin, progress)
    if kept == config.episodes:
        shutil.rmtree(staging)
    return kept


@contextlib.contextmanager
def disk_errors(config: Recipe) -> Iterator[None]:
    """Say what is left of a recording that the disk stops.

    Raises:
        DexFlexError: If it does.
    """
    try:
        yield
    except OSError as error:
        raise DexFlexError(
            f"Recording stopped: {error}. Finished attempts are kept in {staging_folder(config.root)}. "
            "Is the disk full? Free some space, then run the same command again to continue."
        ) from error


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
