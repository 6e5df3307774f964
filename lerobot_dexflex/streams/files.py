"""Stored streams: JSON lines, one record each, so that whatever was written before an interruption counts.

The first line names the format. A point, or the wrist, that is not tracked is null; numbers come back bit for
bit.
"""

import json
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.record import Record
from lerobot_dexflex.streams.source import STALE_AFTER, Newest

FORMAT = {"format": "lerobot_dexflex.streams", "version": 1}
"""First line of a file."""


class StoredStream(NamedTuple):
    """What a file holds."""

    records: tuple[Record, ...]
    torn: bool
    """Whether its writing was interrupted within a line, which is left out."""


class RecordWriter:
    """Writes records, each at once; close it, or use it in a `with`.

    Args:
        path: The file; its folder is made if it is missing.

    Raises:
        DexFlexError: If the file exists, or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("x")
        except OSError as error:
            raise DexFlexError(
                f"{path} cannot be made ({error}). Choose another; nothing was changed."
            ) from error
        self._write(FORMAT)

    def append(self, record: Record) -> None:
        """Write a record."""
        wrist = {"wrist_position": None, "wrist_rotation": None}
        if record.wrist_tracked:
            wrist = {name: getattr(record, name).tolist() for name in wrist}
        points = [
            row if seen else None
            for row, seen in zip(record.keypoints.tolist(), record.tracked.tolist(), strict=True)
        ]
        self._write({"t": record.t, **wrist, "keypoints": points})

    def _write(self, value: dict[str, Any]) -> None:
        self._file.write(json.dumps(value, separators=(",", ":"), allow_nan=False) + "\n")
        self._file.flush()

    def close(self) -> None:
        """Stop writing."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_records(path: Path) -> StoredStream:
    """Return the records of a file.

    Raises:
        DexFlexError: If it is no stored stream, or a line other than one torn at the end is damaged.
    """
    try:
        text = path.read_bytes().decode(errors="replace")
    except OSError as error:
        raise DexFlexError(f"{path} cannot be read ({error}). Check the path.") from error
    header, *lines, rest = text.split("\n") if "\n" in text else ("", "")
    if header != json.dumps(FORMAT, separators=(",", ":")):
        raise DexFlexError(
            f"{path} is no stream of this version: its first line must be {json.dumps(FORMAT)}."
        )
    return StoredStream(
        tuple(_record(line, f"{path}, line {k}") for k, line in enumerate(lines, 2)), torn=bool(rest)
    )


def _record(line: str, where: str) -> Record:
    unknown = np.full((3, 3), np.nan)
    try:
        values = json.loads(line)
        points, place, turn = (values[key] for key in ("keypoints", "wrist_position", "wrist_rotation"))
        tracked = np.array([point is not None for point in points])
        keypoints = [unknown[0] if point is None else point for point in points]
        known = place is not None
        place, turn = (place, turn) if known else (unknown[0], unknown)
        return Record(values["t"], np.array(place), np.array(turn), np.array(keypoints), tracked, known)
    except (ValueError, TypeError, KeyError) as error:
        raise DexFlexError(f"{where} is damaged ({error}). Remove that line.") from error


class ReplaySource:
    """Plays records at the times at which they were made, and says the same each time. Satisfies `Source`.

    The first call starts it. After the last record it is stale.

    Args:
        records: In the order of their times.
        speed: 2 is twice as fast.

    Raises:
        DexFlexError: If there is no record, times go back, or the speed is not positive.
    """

    def __init__(self, records: Sequence[Record], speed: float = 1.0) -> None:
        times = [record.t for record in records]
        if not records or times != sorted(times):
            raise DexFlexError(
                f"A replay needs records whose `t` never goes back. Got {len(records)} records."
            )
        if not 0 < speed < float("inf"):
            raise DexFlexError(f"`speed` must be positive. Got {speed}.")
        self._records, self._times, self._speed = records, times, speed
        self._start: float | None = None

    @property
    def duration(self) -> float:
        """How long it plays [s]."""
        return (self._times[-1] - self._times[0]) / self._speed

    def newest(self, now: float) -> Newest:
        """Return the record of the moment.

        Args:
            now: The caller's clock [s].
        """
        if self._start is None:
            self._start = now
        played = self._times[0] + self._speed * (now - self._start)
        # A clock that adds up ticks is a little short of them.
        k = max(0, bisect_right(self._times, played + 1e-9) - 1)
        return Newest(self._records[k], played - self._times[k] > STALE_AFTER)
