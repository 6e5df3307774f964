"""The console script `dexflex-record`."""

import sys

from lerobot_dexflex import console
from lerobot_dexflex.recording.config import RecordConfig
from lerobot_dexflex.recording.record import record


def main(arguments: list[str] | None = None) -> int:
    """Record demonstrations; return 0 if complete, 1 after an error, 130 after an interrupt.

    Args:
        arguments: Command-line arguments; None takes those of this process.
    """
    return console.run(RecordConfig, lambda config, words: 0 if record(config, words) else 130, arguments)


if __name__ == "__main__":
    sys.exit(main())
