"""Console scripts: parse a configuration with draccus, run it, turn errors into an exit status.

A script imports this before anything heavy: from then on Ctrl-C ends it alike at every moment. Hence the
console scripts start here, and not in their own packages.
"""

import importlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import pairwise
from types import TracebackType
from typing import Any

from lerobot_dexflex.errors import DexFlexError

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def _uncaught(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    """End a script that is interrupted while it imports, where nothing can catch it, like one at work."""
    if not issubclass(kind, KeyboardInterrupt):
        return _python_hook(kind, error, traceback)
    print("Stopped before anything began.", file=sys.stderr)
    sys.exit(INTERRUPTED)


_python_hook = sys.excepthook
sys.excepthook = _uncaught


def record() -> int:
    """Run `dexflex-record`."""
    return _main("lerobot_dexflex.recording.cli")


def corpus() -> int:
    """Run `dexflex-corpus`."""
    return _main("lerobot_dexflex.corpus.cli")


def train() -> int:
    """Run `dexflex-train`."""
    return _main("lerobot_dexflex.training.cli")


def teleop() -> int:
    """Run `dexflex-teleop`."""
    return _main("lerobot_dexflex.teleop.cli")


def hand() -> int:
    """Run `dexflex-hand`."""
    return _main("lerobot_dexflex.hand_check.cli")


def release() -> int:
    """Run `dexflex-release`."""
    return _main("lerobot_policy_dexflex.release")


def names(text: str) -> tuple[str, ...]:
    """Return the words of a comma-separated list."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _main(module: str) -> int:
    return importlib.import_module(module).main()


def run(config_type: type, work: Callable[[Any, list[str]], int], arguments: list[str] | None) -> int:
    """Return the status of `work(config, words)`: 1 after an error of the user, 130 after an interrupt.

    Args:
        config_type: Configuration dataclass.
        work: Called with the configuration and the words it was parsed from.
        arguments: Command-line arguments; None takes those of this process. `--config` is short for
            `--config_path`, and `--flag` of a truth value for `--flag=true`.

    Raises:
        SystemExit: After `--help`.
    """
    try:
        words = _spelled_out(sys.argv[1:] if arguments is None else arguments, config_type)
        config = _parsed(config_type, words)
        return 1 if config is None else work(config, words)
    except (DexFlexError, OSError) as error:
        return _failed(error)
    except KeyboardInterrupt:
        print("Stopped. Run the same command again to continue.", file=sys.stderr)
        return INTERRUPTED


def _parsed(config_type: type, words: list[str]) -> Any:
    """Return the configuration, or None after telling the user what is wrong with it."""
    import draccus
    import yaml
    from draccus.utils import DraccusException

    try:
        return draccus.parse(config_type, args=words)
    except SystemExit as usage:  # argparse has said what it does not understand; draccus' own status is 2.
        if not usage.code:
            raise
    except (DraccusException, yaml.YAMLError, ValueError, TypeError, AttributeError) as error:
        # draccus only says that a class could not be made; our own message is its cause.
        _failed(error.__cause__ if isinstance(error.__cause__, DexFlexError) else error)
    return None


def _failed(error: BaseException) -> int:
    print(f"error: {error}", file=sys.stderr)
    return 1


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
