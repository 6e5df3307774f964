"""The console script `dexflex-corpus`."""

import sys

import draccus
from draccus.utils import DraccusException

from lerobot_dexflex.corpus.config import CorpusConfig
from lerobot_dexflex.corpus.generate import generate
from lerobot_dexflex.errors import DexFlexError


def main(arguments: list[str] | None = None) -> int:
    """Generate a corpus or its replays; return 0 if complete, 1 after an error, 130 after an interrupt.

    Args:
        arguments: Command-line arguments; None takes those of this process. `--config` is short for
            `--config_path`.
    """
    words = sys.argv[1:] if arguments is None else arguments
    words = [_spelled_out(word) for word in words]
    try:
        config = draccus.parse(CorpusConfig, args=words)
        return 0 if generate(config, words) else 130
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


if __name__ == "__main__":
    sys.exit(main())
