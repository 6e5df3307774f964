"""Where numbers come from: the code that an episode imports, weights, packages, command and commit."""

import ast
import functools
import hashlib
import importlib.util
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[1]
_PACKAGES = ("lerobot_dexflex", "lerobot_policy_dexflex")
"""Whose source decides; of all others the installed version is enough."""
_VERSIONS = ("lerobot", "mujoco", "numpy", "torch")
_WEIGHT_SUFFIXES = (".json", ".safetensors")


@dataclass(frozen=True)
class Version:
    """What decides the episodes of a method; two rows with the same version may be compared and mixed."""

    code: str
    """Digest of the source files that are imported to run it."""
    weights: str = ""
    """Digest of its checkpoint and controller, or empty."""
    settings: str = ""
    """Whatever else decides: options, device, batch size, installed packages, renderer; `key=value` words."""

    @property
    def name(self) -> str:
        """Eight hexadecimal digits, for the column `version`."""
        return digest_text(f"{self.code} {self.weights} {self.settings}")[:8]


def method_version(modules: Iterable[str], weights: Iterable[Path] = (), **settings: Any) -> Version:
    """Return the version of a method.

    Args:
        modules: Names of the modules that run it; what they import is found in their source.
        weights: Files or folders of weights; of folders, configuration and weights count, cards do not.
        **settings: Whatever else decides.
    """
    packages = {name: installed(name) for name in _VERSIONS}
    renderer = os.environ.get("MUJOCO_GL", "default")
    words = {**settings, **packages, "renderer": renderer}
    text = " ".join(f"{key}={value}" for key, value in sorted(words.items()) if value not in ("", None))
    folders = [Path(path) for path in weights]
    return Version(code_digest(modules), weights_digest(folders) if folders else "", text)


def code_digest(modules: Iterable[str]) -> str:
    """Return a digest of every byte of these modules and of all that they import from this project."""
    found = ((name, _source(name)) for name in imported(modules))
    return _digest((name, path.read_bytes()) for name, path in found if path)


def weights_digest(paths: Iterable[Path]) -> str:
    """Return a digest of files, and of the configuration and weights in folders."""
    files = [file for path in paths for file in (_weights(path) if path.is_dir() else [path])]
    return _digest((str(n), file.name.encode() + b"\0" + file.read_bytes()) for n, file in enumerate(files))


def imported(modules: Iterable[str]) -> tuple[str, ...]:
    """Return the modules of this project that importing `modules` may load, in order of their names.

    Imports are read from the source, those inside of functions too. What a registry names in a string is not
    seen: whoever makes things from a registry names their modules.

    Raises:
        ModuleNotFoundError: If one of `modules` is none of this project.
    """
    found: set[str] = set()
    waiting = list(modules)
    for name in waiting:
        if _source(name) is None:
            raise ModuleNotFoundError(f"{name!r} is no module of {' or '.join(_PACKAGES)}.")
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        parts = name.split(".")
        waiting += [".".join(parts[:n]) for n in range(1, len(parts))]
        waiting += _imports(name)
    return tuple(sorted(found))


def _imports(name: str) -> list[str]:
    source = _source(name)
    assert source is not None
    return [target for target in _named(source, source.stat().st_mtime_ns) if _source(target)]


@functools.cache
def _named(source: Path, changed: int) -> tuple[str, ...]:
    """Return what a file imports, `from a import b` as both `a` and `a.b`."""
    del changed
    names: list[str] = []
    for node in ast.walk(ast.parse(source.read_bytes())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(name for name in names if name.partition(".")[0] in _PACKAGES)


def _source(name: str) -> Path | None:
    """Return the source file of a module of this project, without importing anything of it."""
    package, _, rest = name.partition(".")
    root = _root(package) if package in _PACKAGES else None
    if root is None:
        return None
    path = root.joinpath(*rest.split(".")) if rest else root
    if (path / "__init__.py").is_file():
        return path / "__init__.py"
    file = path.with_suffix(".py")
    return file if rest and file.is_file() else None


@functools.cache
def _root(package: str) -> Path | None:
    if package == PACKAGE.name:
        return PACKAGE
    spec = importlib.util.find_spec(package)
    return None if spec is None or spec.origin is None else Path(spec.origin).parent


def _weights(folder: Path) -> list[Path]:
    found = [f for f in folder.iterdir() if f.suffix in _WEIGHT_SUFFIXES and f.name != "train_config.json"]
    return sorted(found)


def commit() -> str:
    """Return the commit of this checkout, marked `-dirty` if the library differs from it."""
    try:
        name = _git("rev-parse", "HEAD")
        dirty = _git("status", "--porcelain", "--", str(PACKAGE), str(PACKAGE.parent / "policies"))
    except (OSError, subprocess.CalledProcessError):
        return "not a git checkout"
    return f"{name}-dirty" if dirty else name


def command_line(program: str | None = None, arguments: list[str] | None = None) -> str:
    """Return the command of this process, as one types it.

    Args:
        program: Its name; `python SCRIPT` if None.
        arguments: Its arguments; None takes those of this process.
    """
    words = ["python", sys.argv[0]] if program is None else [program]
    return shlex.join([*words, *(sys.argv[1:] if arguments is None else arguments)])


def now() -> str:
    """Return the time in UTC, ISO 8601."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


def provenance(program: str, modules: Iterable[str], arguments: list[str] | None = None) -> dict[str, Any]:
    """Return command, commit, digest of the code and the versions that matter, for cards.

    Args:
        program: Name of the console script.
        modules: Whose imports decide what it makes.
        arguments: Its arguments; None takes those of this process.
    """
    packages = ("lerobot_policy_dexflex", "lerobot", "mujoco", "numpy")
    return {
        "command": command_line(program, arguments),
        "commit": commit(),
        "code": code_digest(modules),
        "versions": {name: installed(name) for name in packages},
    }


def digest_text(text: str) -> str:
    """Return a digest of a text, 16 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(PACKAGE), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def _digest(parts: Iterable[tuple[str, bytes]]) -> str:
    digest = hashlib.sha256()
    for name, content in sorted(parts):
        digest.update(name.encode() + b"\0" + content + b"\0")
    return digest.hexdigest()[:16]
