"""The console script `dexflex-record`."""

import sys

from lerobot_dexflex import console
from lerobot_dexflex.recording.config import RecordConfig
from lerobot_dexflex.recording.push import then_push
from lerobot_dexflex.recording.record import record


def main(arguments: list[str] | None = None) -> int:
    """Record demonstrations and push them if told to; return 0 if done, 1 after an error, 130 if interrupted.

    Args:
        arguments: Command-line arguments; None takes those of this process.
    """

    def work(config: RecordConfig, words: list[str]) -> int:
        return then_push(config, lambda: record(config, words))

    return console.run(RecordConfig, work, arguments)


if __name__ == "__main__":
    sys.exit(main())
