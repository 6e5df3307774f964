"""Measure the operator's success rate on unseen initial states.

python eval/expert_success.py --task=PlaceHammer-v0 --episodes=200 --seed=200000
"""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot_dexflex import console
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand


@dataclass
class Config:
    """Let a task's operator attempt initial states that no demonstration started from."""

    task: str = "PlaceHammer-v0"
    """A task with an expert."""
    hand: str = "leap"
    """The hand: a name of `lerobot_dexflex.hands`."""
    episodes: int = 200
    """Initial states."""
    seed: int = 200_000
    """Environment seed of the first."""
    workers: int = 2
    """Worker processes; 0 runs in this one."""
    output: Path = Path("outputs/compare")
    """Folder of the rows, as method `expert`; `eval/results` publishes them."""

    def __post_init__(self) -> None:
        get_hand(self.hand)
        if self.workers < 0:
            raise DexFlexError(f"`workers` must not be negative. Got {self.workers}.")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    # Options and help answer at once; the simulator takes seconds to import.
    from lerobot_dexflex.evaluation.comparison import TABLE
    from lerobot_dexflex.recording.expert_rate import expert_rate
    from lerobot_dexflex.runs.statistics import success_rate

    table = config.output / TABLE
    rows = expert_rate(
        get_hand(config.hand), config.task, config.episodes, config.seed, config.workers, table
    )
    rate = success_rate(rows["success"].astype(bool).tolist())
    low, high = rate.pc_success_ci95
    print(
        f"Expert of {config.task}: {rate.n_success}/{rate.n_episodes} "
        f"({rate.pc_success:.1f} %, Wilson 95 % {low:.1f}-{high:.1f} %); rows in {table}"
    )
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
