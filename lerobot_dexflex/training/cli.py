"""The console script `dexflex-train`."""

import sys

import draccus
from draccus.utils import DraccusException

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.training.train import TrainConfig, train


def main(arguments: list[str] | None = None) -> int:
    """Train a controller; return 0 if complete, 1 after an error, 130 after an interrupt.

    Args:
        arguments: Command-line arguments; None takes those of this process.
    """
    try:
        given = sys.argv[1:] if arguments is None else arguments
        folder = train(draccus.parse(TrainConfig, args=[_long_name(a) for a in given]))
        print(f"The controller is in {folder}.")
        return 0
    except (DexFlexError, DraccusException, OSError) as error:
        print(f"error: {_reason(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("Stopped. Run the same command again to continue.", file=sys.stderr)
        return 130


def _long_name(argument: str) -> str:
    """Let `--config` stand for draccus's `--config_path`."""
    name, equals, value = argument.partition("=")
    return f"--config_path{equals}{value}" if name == "--config" else argument


def _reason(error: BaseException) -> BaseException:
    """Return our own message where draccus only says that a class could not be made."""
    cause = error.__cause__
    return cause if isinstance(error, DraccusException) and isinstance(cause, DexFlexError) else error


if __name__ == "__main__":
    sys.exit(main())
