"""Search the settings of `press` at random, on training objects, and say what each is worth.

python eval/search_press.py --trials=400

Interrupt with Ctrl-C and run the same command again to continue; more trials extend it.
"""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot_dexflex import console
from lerobot_dexflex.errors import DexFlexError

OUTPUT = Path("outputs/degraded")


@dataclass
class Config:
    """Search the settings of the hand-written grip at random, with drafts of motion and pressing ones."""

    trials: int = 400
    """Settings to draw, 16 episodes each; every second trial has pressing drafts."""
    n_chains: int = 250
    """Starts to draw from."""
    workers: int = 2
    """Worker processes; 0 runs in this one. The rows do not depend on it."""
    output: Path = OUTPUT / "search"
    """Folder of the table."""
    chains: Path = OUTPUT / "chains"
    """Folder of goal chains, built where missing."""

    def __post_init__(self) -> None:
        for name in ("trials", "n_chains"):
            if getattr(self, name) < 1:
                raise DexFlexError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        if self.workers < 0:
            raise DexFlexError(f"`workers` must not be negative. Got {self.workers}.")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    from lerobot_dexflex.evaluation.reach.search import SOURCES, Search, fit, run_search

    rows = run_search(Search(config.output, config.chains, config.n_chains), config.trials, config.workers)
    parts = {"both": rows} | {source: rows[rows["source"] == source] for source in SOURCES}
    for name, part in parts.items():
        effects = fit(part)
        print(f"\nDrafts: {name}. {len(part)} episodes, mean progress {part['progress'].mean():.3f}")
        print("\n| setting | half the range is worth | best |\n| --- | --- | --- |")
        for effect in effects:
            print(f"| {effect.name} | {effect.slope:+.3f} ± {effect.error:.3f} | {effect.best:.4g} |")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
