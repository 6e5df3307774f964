"""Where data come from: code, commit, versions and command, for cards and for safe resuming."""

import hashlib
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]
_DECISIVE = (
    *("hand", "envs", "experts", "interfaces", "controller"),
    *(f"recording/{name}.py" for name in ("attempt", "operation", "schema")),
)


def code_digest() -> str:
    """Return a digest of all source files that decide what an episode contains."""
    files = [file for part in _DECISIVE for file in _python_files(PACKAGE / part)]
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.relative_to(PACKAGE).as_posix().encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def _python_files(path: Path) -> list[Path]:
    return [path] if path.is_file() else list(path.rglob("*.py"))


def commit() -> str:
    """Return the commit of this checkout, marked `-dirty` if the package differs from it."""
    try:
        name = _git("rev-parse", "HEAD")
        dirty = _git("status", "--porcelain", "--", str(PACKAGE))
    except (OSError, subprocess.CalledProcessError):
        return "not a git checkout"
    return f"{name}-dirty" if dirty else name


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(PACKAGE), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def provenance(program: str, arguments: list[str] | None = None) -> dict[str, Any]:
    """Return command, commit, code digest and the versions that matter.

    Args:
        program: Name of the console script.
        arguments: Its arguments; None takes those of this process.
    """
    words = [program, *(sys.argv[1:] if arguments is None else arguments)]
    packages = ("lerobot_policy_dexflex", "lerobot", "mujoco", "numpy")
    return {
        "command": shlex.join(words),
        "commit": commit(),
        "code": code_digest(),
        "versions": {name: version(name) for name in packages},
    }
