"""Replay a recorded dataset through interfaces, from the same initial states, beside the expert's rate.

python eval/replay_dataset.py --root=datasets/place_hammer --methods=raw,press:4 --conditions=clean,noise_2mm
"""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot_dexflex import console
from lerobot_dexflex.errors import DexFlexError


@dataclass
class Config:
    """Execute a dataset's actions again through interfaces: do its labels solve its task?"""

    root: Path = Path("datasets/place_hammer")
    """Folder of a dataset that `dexflex-record` wrote."""
    methods: str = "raw"
    """Names of methods, separated by commas."""
    draft: str = "measured"
    """Where drafts lead: to the fingertips that were `measured` one step after each action, which hold no
    force, or to the `commanded` ones."""
    conditions: str = "clean"
    """What goes wrong, separated by commas, such as `clean,noise_4mm`."""
    workers: int = 2
    """Worker processes; 0 runs in this one."""
    output: Path = Path("outputs/compare")
    """Folder of the rows, as `replay_<draft>/<method>`; `eval/results` publishes them."""

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise DexFlexError(f"`workers` must not be negative. Got {self.workers}.")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    from lerobot_dexflex.evaluation.comparison import Comparison, compare
    from lerobot_dexflex.evaluation.replay import Replays, load_demonstrations
    from lerobot_dexflex.evaluation.report.table import as_markdown, rate_header, rate_rows
    from lerobot_dexflex.evaluation.summary import summarise

    demonstrations = load_demonstrations(config.root)
    conditions = console.names(config.conditions)
    comparison = Comparison(
        players={demonstrations.task: Replays(config.root, config.draft)},
        methods=console.names(config.methods),
        output=config.output,
        conditions=conditions,
        seeds=demonstrations.seeds,
        label=f"replay_{config.draft}",
        cameras=False,
    )
    rows = compare(comparison, config.workers)
    methods = [comparison.named(method) for method in comparison.methods]
    summary = summarise(rows, methods, "condition", conditions)
    successes, attempts = demonstrations.expert
    print(f"\n{as_markdown(rate_header(summary), rate_rows(summary))}")
    print(f"\nThe expert succeeded in {successes} of {attempts} attempts; its successes were replayed.")
    print(f"Rows: {comparison.table}")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
