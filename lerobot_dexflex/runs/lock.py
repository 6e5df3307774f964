"""One process per folder: a second one is refused, and told who works there."""

import contextlib
import fcntl
import json
import os
import shlex
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

from lerobot_dexflex.errors import DexFlexError


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder while working in it.

    The lock lies beside the folder, `.NAME.lock`, so that the folder itself may be replaced. The operating
    system lets go of it when the process ends, however it ends.

    Args:
        folder: What is worked on; it need not exist.

    Raises:
        DexFlexError: If another process holds it; says which.
    """
    where = folder.resolve()
    path = where.with_name(f".{where.name}.lock")
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _take(path, folder)
    try:
        owner = {"pid": os.getpid(), "host": socket.gethostname(), "command": shlex.join(sys.argv)}
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(owner).encode(), 0)
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(descriptor)


def _take(path: Path, folder: Path) -> int:
    """Return the descriptor of the lock, which no other process holds."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.exists() and os.path.samestat(os.fstat(descriptor), path.stat()):
                return descriptor
        except BlockingIOError as error:
            os.close(descriptor)
            raise DexFlexError(
                f"{folder} is in use by {_holder(path)}. Wait until it ends, stop it, or choose another "
                "folder; nothing was changed."
            ) from error
        os.close(descriptor)  # Its last holder has just removed the file that was opened here.


def _holder(path: Path) -> str:
    try:
        owner = json.loads(path.read_text())
        return f"process {owner['pid']} on {owner['host']} ({owner['command']})"
    except (OSError, ValueError, KeyError):
        return "another process"
