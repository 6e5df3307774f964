"""Console scripts: parse a configuration with draccus, run it, turn errors into an exit status."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import pairwise
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
            `--config_path`, and `--flag` of a truth value for `--flag=true`.
    """
    words = _spelled_out(sys.argv[1:] if arguments is None else arguments, config_type)
    try:
        return work(draccus.parse(config_type, args=words), words)
    except (DexFlexError, DraccusException, OSError) as error:
        print(f"error: {_reason(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Stopped. Run the same command again to continue.", file=sys.stderr)
        return 130


def _spelled_out(words: Sequence[str], config_type: type) -> list[str]:
    switches = {f"--{field.name}" for field in fields(config_type) if field.type is bool}
    spelled = []
    for word, following in pairwise([*words, "--"]):
        name, equals, value = word.partition("=")
        if name == "--config":
            spelled.append(f"--config_path{equals}{value}")
        elif word in switches and following.startswith("--"):
            spelled.append(f"{word}=true")
        else:
            spelled.append(word)
    return spelled


def _reason(error: BaseException) -> BaseException:
    """Return our own message where draccus only says that a class could not be made."""
    cause = error.__cause__
    return cause if isinstance(error, DraccusException) and isinstance(cause, DexFlexError) else error
