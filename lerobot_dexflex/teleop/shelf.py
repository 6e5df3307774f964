"""The attempts of a live recording, each safe on disk as soon as it is decided."""

import contextlib
import dataclasses
from collections.abc import Iterator
from typing import Any

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.recording.assembly import disk_errors, origin_of, write_dataset
from lerobot_dexflex.recording.attempt import Attempt, save_attempt
from lerobot_dexflex.recording.recipe import Recipe
from lerobot_dexflex.recording.staging import is_complete, open_staging, staged_attempts
from lerobot_dexflex.runs.lock import locked


class Shelf:
    """Where attempts go. Whatever ends the process, what was put here is there the next time.

    Args:
        config: The recipe.
        arguments: Command-line arguments for the card; None takes those of this process.

    Raises:
        DexFlexError: If there is a recording of another recipe, or of more episodes than are asked for.
    """

    def __init__(self, config: Recipe, arguments: list[str] | None = None) -> None:
        self._config = config
        self._origin: dict[str, Any] = origin_of(config, arguments)
        self._staging = open_staging(config)
        self._attempts = staged_attempts(self._staging)
        if self.kept > config.episodes:
            raise DexFlexError(
                f"{self._staging} holds {self.kept} episodes. `episodes` must be at least that. "
                f"Got {config.episodes}."
            )

    @property
    def kept(self) -> int:
        """Episodes so far."""
        return sum(attempt.kept for attempt in self._attempts.values())

    @property
    def next_index(self) -> int:
        """Number of the next attempt; of none before, in whatever session."""
        return max(self._attempts, default=-1) + 1

    def put(self, attempt: Attempt) -> None:
        """Store an attempt; it is whole on disk when this returns."""
        save_attempt(attempt, self._staging)
        self._attempts[attempt.index] = dataclasses.replace(attempt, frames={})

    def close(self) -> None:
        """Write the dataset of all that is kept; leave nothing behind if there was no attempt.

        Raises:
            DexFlexError: If it cannot be written; no attempt is lost.
        """
        if not self._attempts:
            (self._staging / "manifest.json").unlink()
            self._staging.rmdir()
            return
        attempts = [self._attempts[index] for index in sorted(self._attempts)]
        episodes = write_dataset(self._config, self._staging, attempts, self._origin)
        if episodes:
            print(f"{episodes} of {self._config.episodes} episodes are in {self._config.root}.")
        if episodes < self._config.episodes:
            print("The same command goes on with this recording.")


@contextlib.contextmanager
def open_shelf(config: Recipe, arguments: list[str] | None = None) -> Iterator[Shelf | None]:
    """Open the shelf of a recording for as long as a session lasts; then write its dataset.

    Yields:
        The shelf; None if the recording is complete already.

    Raises:
        DexFlexError: As `Shelf`; or if another process records there, or the disk is full.
    """
    with disk_errors(config), locked(config.root):
        if is_complete(config):
            yield None
            return
        shelf = Shelf(config, arguments)
        try:
            yield shelf
        finally:
            shelf.close()
