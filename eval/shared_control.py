"""Shared control of tools: a simulated person leads the hand through interfaces (paper, Table 2).

python eval/shared_control.py
python eval/shared_control.py --tasks=HammerNail-v0 --methods=joint,raw --episodes=12 --seed=53000

Tables, tests, a report with films, and pictures of when interfaces intervene (paper, Fig. 4). Interrupt with
Ctrl-C and run the same command again to continue.
"""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_dexflex import console
from lerobot_dexflex.commands.levels import LEVELS
from lerobot_dexflex.commands.source import check_source, operator_label
from lerobot_dexflex.console import names
from lerobot_dexflex.envs.registration import TOOLS, check_tasks
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand

METHODS = (
    "raw,filter,press:1,projection,dexgen:use_splitter=True,dexflex-notouch:use_splitter=True,"
    "dexflex:use_splitter=True"
)
"""Below a person who presses. The controller takes the squeeze out of the draft and supplies its own."""


@dataclass
class Config:
    """Compare interfaces below a simulated person who uses tools, on the same episodes."""

    tasks: str = ",".join(TOOLS)
    """Names of tasks, separated by commas."""
    methods: str = METHODS
    """`name[-ablation][:options][@gain],...`; `joint` executes the operator's own joints."""
    hand: str = "leap"
    """The hand: a name of `lerobot_dexflex.hands`."""
    level: str = "novice"
    """How well the person leads, of `commands.levels.LEVELS`; empty: without errors. By default the level at
    which `raw` succeeded as often below this operator, on tuning seeds, as below the paper's people."""
    source: str = "pressing"
    """What the person's drafts say: `pressing`, where fingertips should be and the squeeze, or `motion`."""
    episodes: int = 100
    """Per task and method."""
    seed: int = 400_000
    """Episode i starts from environment seed `seed + i`; no operator was tuned on the default and above."""
    controller: str = ""
    """Folder or hub id of the controller of dexgen and dexflex; default: the shipped one."""
    workers: int = 2
    """Worker processes; 0 runs in this one. Rows do not depend on it."""
    output: Path = Path("outputs/shared_control")
    """Folder of the rows and the report."""
    videos: int = 1
    """Film the first so many episodes of every task, and draw when interfaces intervened."""
    rerun: bool = False
    """Also log the filmed episodes as `.rrd` for rerun."""

    def __post_init__(self) -> None:
        if self.level not in ("", *LEVELS):
            raise DexFlexError(f"`level` must be empty or one of {', '.join(LEVELS)}. Got {self.level!r}.")
        check_tasks(names(self.tasks))
        get_hand(self.hand)


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    # Seconds of imports that --help and a mistyped option need not pay.
    from lerobot_dexflex.evaluation.comparison import compare
    from lerobot_dexflex.evaluation.report.page import write_report

    comparison = build(config)
    print(f"{', '.join(comparison.methods)} into {comparison.table}", flush=True)
    text, page = write_report(comparison, compare(comparison, config.workers))
    print(f"\n{text}\n\nReport: {page}")
    return 0


def build(config: Config) -> Any:
    """Return the comparison that a configuration describes.

    Raises:
        DexFlexError: If a method, the source or a controller does not exist or does not fit.
    """
    from lerobot_dexflex.evaluation.comparison import Comparison
    from lerobot_dexflex.evaluation.conditions import CLEAN
    from lerobot_dexflex.evaluation.teleoperators import Teleoperators
    from lerobot_dexflex.interfaces.method import Method

    source, hand = check_source(config.source), get_hand(config.hand)
    return Comparison(
        players={task: Teleoperators(hand, task, config.controller, source) for task in names(config.tasks)},
        methods=tuple(Method.parse(name).name for name in names(config.methods)),
        output=config.output,
        conditions=(config.level or CLEAN,),
        seeds=range(config.seed, config.seed + config.episodes),
        label=operator_label(source),
        cameras=False,
        videos=config.videos,
        rerun=config.rerun,
    )


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
