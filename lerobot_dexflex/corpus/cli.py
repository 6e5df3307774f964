"""The console script `dexflex-corpus`."""

import sys

from lerobot_dexflex import console
from lerobot_dexflex.corpus.config import CorpusConfig
from lerobot_dexflex.corpus.generate import generate


def main(arguments: list[str] | None = None) -> int:
    """Generate a corpus; return 0 if complete, 1 after an error, 130 after an interrupt.

    Args:
        arguments: Command-line arguments; None takes those of this process.
    """
    return console.run(CorpusConfig, lambda config, words: 0 if generate(config, words) else 130, arguments)


if __name__ == "__main__":
    sys.exit(main())
