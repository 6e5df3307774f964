"""The console script `dexflex-train`."""

import sys

from lerobot_dexflex import console
from lerobot_dexflex.training.train import TrainConfig, train


def main(arguments: list[str] | None = None) -> int:
    """Train a controller; return 0 if complete, 1 after an error, 130 after an interrupt.

    Args:
        arguments: Command-line arguments; None takes those of this process.
    """

    def work(config: TrainConfig, words: list[str]) -> int:
        del words
        print(f"The controller is in {train(config)}.")
        return 0

    return console.run(TrainConfig, work, arguments)


if __name__ == "__main__":
    sys.exit(main())
