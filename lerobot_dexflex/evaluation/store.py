"""The folder of a comparison: finished episodes survive interrupts, changed settings are refused."""

import json
import os
from collections.abc import Callable, Hashable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

from lerobot_dexflex.errors import DexFlexError

SETTINGS, EPISODES = "settings.json", "episodes.jsonl"


class Storable(Protocol):
    """An episode's result."""

    @property
    def job(self) -> Hashable:
        """What was run together with this episode."""
        ...

    @property
    def group(self) -> tuple[int, int]:
        """First and one past the last episode of the job."""
        ...

    @property
    def episode(self) -> int:
        """Number of the episode."""
        ...

    def line(self) -> str:
        """Return the result as one line of JSON."""
        ...


class Store[Result: Storable]:
    """Finished episodes of one comparison.

    Args:
        root: Folder; created if missing.
        identity: Settings on which every episode depends, flat.
        parse: Inverse of a result's `line`; raises ValueError for a torn line.

    Raises:
        DexFlexError: If the folder belongs to something else or to other settings.
    """

    def __init__(self, root: Path, identity: dict[str, Any], parse: Callable[[str], Result]) -> None:
        self.root, self._parse = root, parse
        self._settings = root / SETTINGS
        if root.exists() and not root.is_dir():
            raise DexFlexError(f"The output {root} is a file; choose a folder.")
        if self._settings.exists():
            _refuse_changes(root, json.loads(self._settings.read_text())["identity"], identity)
            return
        if root.exists() and any(root.iterdir()):
            raise DexFlexError(
                f"The output folder {root} exists and is no comparison (it has no {SETTINGS}). "
                "Choose another --output or remove it."
            )
        root.mkdir(parents=True, exist_ok=True)
        write_json(self._settings, {"identity": identity, "sessions": []})

    def append(self, outcomes: Sequence[Result]) -> None:
        """Append a finished group in one write; safe from several processes."""
        lines = "".join(outcome.line() for outcome in outcomes).encode()
        descriptor = os.open(self.root / EPISODES, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        try:
            os.write(descriptor, lines)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def load(self) -> list[Result]:
        """Return the episodes of completely finished groups, each once; drops a torn last line."""
        file = self.root / EPISODES
        if not file.exists():
            return []
        found: dict[Hashable, dict[int, Result]] = {}
        for line in file.read_text().splitlines():
            try:
                outcome = self._parse(line)
            except ValueError:
                continue
            found.setdefault(outcome.job, {})[outcome.episode] = outcome
        whole = [
            o for group in found.values() for o in group.values() if len(group) == o.group[1] - o.group[0]
        ]
        _write(file, "".join(outcome.line() for outcome in whole))
        return whole

    def add_session(self, session: dict[str, Any]) -> None:
        """Remember command, commit and duration of a run that worked in this folder."""
        settings = json.loads(self._settings.read_text())
        settings["sessions"].append(session)
        write_json(self._settings, settings)

    def identity(self) -> dict[str, Any]:
        """Return the settings on which every episode depends."""
        return json.loads(self._settings.read_text())["identity"]

    def sessions(self) -> list[dict[str, Any]]:
        """Return the runs that worked in this folder."""
        return json.loads(self._settings.read_text())["sessions"]


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically."""
    _write(path, json.dumps(value, indent=2) + "\n")


def _write(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text)
    temporary.replace(path)


def _refuse_changes(root: Path, stored: dict[str, Any], wanted: dict[str, Any]) -> None:
    keys: Iterable[str] = dict.fromkeys((*stored, *wanted))
    changes = [
        f"  {k}: {stored.get(k)!r} in the folder, {wanted.get(k)!r} now"
        for k in keys
        if stored.get(k) != wanted.get(k)
    ]
    if changes:
        raise DexFlexError(
            f"The output folder {root} holds a comparison with other settings:\n"
            + "\n".join(changes)
            + "\nRestore these settings to continue it, or choose another --output."
        )
