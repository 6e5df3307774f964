"""What decides the numbers of a comparison: code, checkpoints, versions."""

import hashlib
import importlib.util
import json
import os
import shlex
import sys
import time
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lerobot_dexflex.runs.provenance import commit

_PACKAGE = Path(__file__).resolve().parents[1]
_DECISIVE = (
    *("hand", "envs", "controller", "interfaces", "commands/corruption.py"),
    *(f"evaluation/{name}.py" for name in ("rollout", "outcome", "command_errors")),
)
"""Parts of the library that decide what happens in an episode, beside the policy plugin."""
_PLUGIN = "lerobot_policy_dexflex"
_VERSIONS = ("lerobot", "mujoco", "numpy", "torch")
_CHECKPOINT_SUFFIXES = (".json", ".safetensors")


def code_digest(parts: Sequence[str] = _DECISIVE, policies: bool = True) -> str:
    """Return a digest of all source files that decide what happens in an episode.

    Args:
        parts: Folders and files of this package.
        policies: Whether the policy plugin decides as well.
    """
    files = [(_PACKAGE, file) for part in parts for file in _sources(_PACKAGE / part)]
    plugin = importlib.util.find_spec(_PLUGIN) if policies else None
    if plugin is not None and plugin.origin is not None:
        folder = Path(plugin.origin).parent
        files += [(folder.parent, file) for file in _sources(folder)]
    return _digest(files)


def checkpoint_digest(folder: Path) -> str:
    """Return a digest of a checkpoint's weights, configuration and processors, not of its card."""
    files = [
        f for f in folder.iterdir() if f.suffix in _CHECKPOINT_SUFFIXES and f.name != "train_config.json"
    ]
    return _digest((folder, file) for file in files)


def environment_identity() -> dict[str, str]:
    """Return what of this installation can change results: code, versions, renderer."""
    versions = {f"version.{name}": version(name) for name in _VERSIONS}
    return {"code": code_digest(), "renderer": os.environ.get("MUJOCO_GL", "default"), **versions}


def session(started: float, episodes: int, workers: int) -> dict[str, Any]:
    """Return command, commit and duration of a run that began at `started` [s since the epoch]."""
    return {
        "command": shlex.join(["python", *sys.argv]),
        "commit": commit(),
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(started)),
        "wall_time_s": round(time.time() - started, 1),
        "episodes_run": episodes,
        "workers": workers,
    }


def session_provenance(sessions: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what a result file tells of the runs that it comes from."""
    last = {key: sessions[-1][key] for key in ("command", "commit")}
    return last | {"wall_time_s": round(sum(s["wall_time_s"] for s in sessions), 1), "sessions": sessions}


def identity_digest(identity: dict[str, Any]) -> str:
    """Return a short digest of a comparison's settings."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:8]


def _sources(path: Path) -> list[Path]:
    return [path] if path.is_file() else list(path.rglob("*.py"))


def _digest(files: Iterable[tuple[Path, Path]]) -> str:
    digest = hashlib.sha256()
    for name, file in sorted((file.relative_to(root).as_posix(), file) for root, file in files):
        digest.update(name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]
