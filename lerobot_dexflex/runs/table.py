"""Results on disk: one CSV row per episode, appended and never changed, and where each version came from."""

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.runs.provenance import Version, command_line, commit, now

KEY = ("method", "version", "task", "condition", "seed")
"""What tells rows apart; a row that is there twice counts once, the first."""
RUNS = "runs.csv"
_ORIGIN = ("version", "method", "command", "commit", "code", "weights", "settings", "date")
_TEXT = (*KEY[:-1], *_ORIGIN, "chain", "ending")

Row = dict[str, Any]
"""Values by column; None is an empty cell."""


class Table:
    """A CSV file of episodes and, beside it, `runs.csv`, which every table of the folder shares.

    Whoever appends must hold the folder (`runs.lock.locked`); its workers may append as well, each some rows
    in one write.

    Args:
        path: The CSV file; created with its header if missing.
        columns: Columns that will be written beside `KEY`; new ones are added to an older file.

    Raises:
        DexFlexError: If the file is no table of episodes.
    """

    def __init__(self, path: Path, columns: Sequence[str] = ()) -> None:
        self.path, self.runs = path, path.with_name(RUNS)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.columns = _open(path, (*KEY, *(c for c in columns if c not in KEY)), KEY)
        _open(self.runs, _ORIGIN, _ORIGIN)

    def append(self, rows: Sequence[Row]) -> None:
        """Append rows in one write, whole or not at all; safe from several processes."""
        if strangers := sorted({name for row in rows for name in row} - set(self.columns)):
            raise DexFlexError(
                f"{self.path} has no columns {', '.join(strangers)}. Valid: {', '.join(self.columns)}."
            )
        _append(self.path, self.columns, rows)

    def load(self) -> pd.DataFrame:
        """Return all rows, each once; a row that a kill tore off is left out."""
        return read(self.path)

    def origins(self) -> pd.DataFrame:
        """Return `runs.csv`: command, commit, digests, settings and date of every version."""
        return read(self.runs)

    def remember(self, method: str, version: Version) -> None:
        """Note that this process adds rows of a version; once for every command and commit."""
        row = {
            "version": version.name,
            "method": method,
            "command": command_line(),
            "commit": commit(),
            "code": version.code,
            "weights": version.weights,
            "settings": version.settings,
        }
        known = self.origins().fillna("").to_dict("records")
        if not any(row.items() <= old.items() for old in known):
            _append(self.runs, _ORIGIN, [row | {"date": now()}])


def _open(path: Path, columns: tuple[str, ...], needed: tuple[str, ...]) -> tuple[str, ...]:
    """Make the file ready to be appended to; returns its columns."""
    if path.exists() and not path.is_file():
        raise DexFlexError(f"{path} is no file; choose another one for the results.")
    content = path.read_bytes() if path.exists() else b""
    header, newline, _ = content.partition(b"\n")
    if not newline and ",".join(columns).startswith(header.decode(errors="replace")):
        _replace(path, ",".join(columns) + "\n")  # New, or a kill tore its header off.
        return columns
    found = tuple(header.decode(errors="replace").split(","))
    if missing := [name for name in needed if name not in found]:
        raise DexFlexError(
            f"{path} is no table of episodes: it lacks the columns {', '.join(missing)}. Choose another "
            "folder; nothing was changed."
        )
    if not content.endswith(b"\n"):  # A kill tore the last line off; its episode runs again.
        _replace(path, content[: content.rfind(b"\n") + 1].decode())
    if added := [name for name in columns if name not in found]:
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
        for name in added:
            table[name] = ""
        _replace(path, table.to_csv(index=False, lineterminator="\n"))
    return (*found, *added)


def read(path: Path) -> pd.DataFrame:
    """Return the rows of a file that a `Table` wrote, each once, and leave the file alone.

    A row that a kill tore off is left out; so are headers between rows, of files that were concatenated.

    Raises:
        DexFlexError: If there is no such file, or a line of it is damaged.
    """
    try:
        text = path.read_text()
        header = text.partition("\n")[0]
        whole = text[: text.rfind("\n") + 1].replace(f"\n{header}\n", "\n")
        kinds: Any = {name: str for name in header.split(",") if name in _TEXT}
        rows = pd.read_csv(io.StringIO(whole), dtype=kinds)
    except FileNotFoundError as error:
        raise DexFlexError(f"There are no results: {path} not found.") from error
    except ValueError as error:
        raise DexFlexError(f"{path} cannot be read ({error}). Repair or remove that line.") from error
    keys = [name for name in KEY if name in rows] if "seed" in rows else list(rows)
    return rows.drop_duplicates(keys, ignore_index=True)


def _append(path: Path, columns: Sequence[str], rows: Sequence[Row]) -> None:
    text = pd.DataFrame(rows, columns=pd.Index(columns)).to_csv(
        index=False, header=False, lineterminator="\n"
    )
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
    try:
        os.write(descriptor, text.encode())
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _replace(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text)
    temporary.replace(path)
