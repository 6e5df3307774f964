"""The console script `dexflex-teleop`."""

import sys

from lerobot_dexflex import console
from lerobot_dexflex.recording.push import then_push
from lerobot_dexflex.teleop.config import TeleopConfig
from lerobot_dexflex.teleop.operate import operate


def main(arguments: list[str] | None = None) -> int:
    """Operate live, and push what was recorded if told to; return 0, 1 after an error, 130 if interrupted.

    Args:
        arguments: Command-line arguments; None takes those of this process.
    """

    def work(config: TeleopConfig, words: list[str]) -> int:
        return then_push(config, lambda: operate(config, words))

    return console.run(TeleopConfig, work, arguments)


if __name__ == "__main__":
    sys.exit(main())
