"""Degrade an operator's drafts and compare who follows the intent: tables, tests, a report with a film.

python eval/degraded_commands.py --methods=raw,press,dexflex --conditions=clean,removal_2mm,pressing

Interrupt with Ctrl-C and run the same command again to continue; more methods, conditions or episodes extend
it.
"""

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from lerobot_dexflex import console
from lerobot_dexflex.errors import DexFlexError

METHODS = "raw,press,press:blocked=True,projection,dexgen,dexflex,forces,operator"
CONDITIONS = (
    "clean,noise_2mm,scale_1.5,delay_2,removal_2mm,removal_3mm,bias_1mm,"
    "pressing,noise_2mm+pressing,scale_1.5+pressing,delay_2+pressing,"
    "removal_2mm+pressing,removal_3mm+pressing,bias_1mm+pressing"
)
EPISODES = 300
GRID_METHODS = tuple(
    f"dexflex:n_finger=0+n_pure={count // 2}+n_seeded={count - count // 2}+nfe={evaluations}"
    for count in (4, 16, 64)
    for evaluations in (1, 4)
)
OUTPUT = Path("outputs/degraded")
DEMO_METHODS, DEMO_CONDITIONS, DEMO_EPISODES = "raw,press,forces,operator", "clean,removal_3mm", 8


@dataclass
class Config:
    """Compare methods under degraded drafts on the same episodes of moving an object in the hand."""

    methods: str = ""
    """`name[-ablation][:options][@gain],...`; also the upper bounds `operator`, `forces`, `oracle`. Empty:
    see `METHODS`."""
    conditions: str = ""
    """What goes wrong, separated by commas, such as `removal_2mm` or `delay_2+noise_2mm`; `+pressing` for
    drafts that command into the object, `+verified` for goals that the operator reaches. Empty: seven with
    both sources, see `CONDITIONS`."""
    ablations: bool = False
    """Also run all ablations of dexflex."""
    grid: bool = False
    """Also run dexflex by numbers of candidates and function evaluations."""
    episodes: int = 0
    """Per method and condition; 0 means 300, or 8 with `demo`."""
    oracle_episodes: int = 48
    """Per condition for oracles, which are slow."""
    hand: str = "leap"
    """Name of the hand."""
    controller: str = ""
    """Folder or hub id of the trained controller; empty: the shipped one."""
    reference: str = ""
    """Method that all others are tested against; empty: dexflex."""
    tuning: bool = False
    """Run on the tuning objects: for choosing gains and settings."""
    workers: int = 2
    """Worker processes; 0 runs in this one."""
    batch: int = 16
    """Hands side by side in a worker."""
    group: int = 100
    """Episodes that are run and stored together."""
    output: Path | None = None
    """Folder; `outputs/degraded/{test,tuning,demo}` if not given, with the name of another hand in front."""
    chains: Path = OUTPUT / "chains"
    """Folder of goal chains, built where missing."""
    films: bool = True
    """Run an episode again to film it."""
    demo: bool = False
    """Run a few episodes of methods that need no training."""

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise DexFlexError(f"`workers` must not be negative. Got {self.workers}.")
        if self.episodes < 0:
            raise DexFlexError(f"`episodes` must not be negative. Got {self.episodes}.")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    del words
    # Seconds of imports that --help and a mistyped option need not pay.
    from lerobot_dexflex.evaluation.reach.benchmark import Benchmark, run
    from lerobot_dexflex.evaluation.reach.report import write_report
    from lerobot_dexflex.evaluation.reach.summary import summarise
    from lerobot_dexflex.evaluation.reach.tables import markdown
    from lerobot_dexflex.interfaces.registry import INTERFACES

    methods, conditions, episodes = METHODS, CONDITIONS, EPISODES
    if config.demo:
        methods, conditions, episodes = DEMO_METHODS, DEMO_CONDITIONS, DEMO_EPISODES
    kind = "demo" if config.demo else "tuning" if config.tuning else "test"
    ablations = [f"dexflex-{name}" for name in INTERFACES["dexflex"].ablations] if config.ablations else []
    variants = (*ablations, *GRID_METHODS * config.grid)
    benchmark = Benchmark(
        methods=(*console.names(config.methods or methods), *variants),
        conditions=console.names(config.conditions or conditions),
        output=config.output or OUTPUT / (kind if config.hand == Config.hand else f"{config.hand}_{kind}"),
        chains=config.chains,
        episodes=config.episodes or episodes,
        oracle_episodes=config.oracle_episodes,
        controller=config.controller,
        hand=config.hand,
        tuning=config.tuning or config.demo,
        group=config.group,
        batch=config.batch,
    )
    count = f"{len(benchmark.methods)} methods under {len(benchmark.conditions)} conditions"
    print(f"{count} into {benchmark.table}", flush=True)
    rows = run(benchmark, config.workers)
    summary = summarise(rows, benchmark.methods, benchmark.conditions, config.reference or None)
    page = write_report(benchmark, summary, films=config.films)
    print(f"\n{markdown(summary)}\n\nReport: {page}")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
