"""Console scripts: parse a configuration with draccus, run it, turn errors into an exit status."""

import sys
from collections.abc import Callable
from typing import Any

import draccus
from draccus.utils import DraccusException

from lerobot_dexflex.errors import DexFlexError


def run(config_type: type, work: Callable[[Any, list[str]], int], arguments: list[str] | None) -> int:
    """Return the status of `work(config, words)`: 1 after an error, 130 after an interrupt.

    Args:
        config_type: Configuration dataclass.
        work: Called with the configuration and the words it was parsed from.
        arguments: Command-line arguments; None takes those of this process. `--config` is short for
            `--config_path`.
    """
    words = [_spelled_out(word) for word in (sys.argv[1:] if arguments is None else arguments)]
    try:
        return work(draccus.parse(config_type, args=words), words)
    except (DexFlexError, DraccusException, OSError) as error:
        print(f"error: {_reason(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Stopped. Run the same command again to continue.", file=sys.stderr)
        return 130


def _spelled_out(word: str) -> str:
    name, equals, value = word.partition("=")
    return f"--config_path{equals}{value}" if name == "--config" else word


def _reason(error: BaseException) -> BaseException:
    """Return our own message where draccus only says that a class could not be made."""
    cause = error.__cause__
    return cause if isinstance(error, DraccusException) and isinstance(cause, DexFlexError) else error
