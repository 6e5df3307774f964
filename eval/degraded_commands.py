"""Degrade an operator's commands and compare who recovers the intent: tables, tests, a report with a film.

python eval/degraded_commands.py --methods raw,shrink:0.5,dexflex --cells clean,removal_2mm --episodes 300

Interrupt with Ctrl-C and run the same command again to continue; more methods, cells or episodes extend it.
"""

import argparse
import os
import sys
from pathlib import Path

from lerobot_dexflex.errors import DexFlexError

METHODS = (
    "raw,filter,hold,shrink:0.5,shrink:0.7,clip:0.0015,reflex,dexgen,dexgen@0.7,dexflex,dexflex@0.7,clean"
)
CELLS = "clean,noise_1mm,noise_2mm,scale_1.5,delay_2,removal_2mm,removal_3mm"
ABLATION_METHODS = tuple(
    f"dexflex-{name}" for name in ("noscore", "notouch", "noconsequence", "nopure", "noseeded", "noslow")
)
GRID_METHODS = tuple(
    f"dexflex:n_pure={count // 2}+n_seeded={count - count // 2 - 2}+nfe={evaluations}"
    for count in (4, 16, 64)
    for evaluations in (1, 4)
)
OUTPUT = Path("outputs/degraded")
DEMO = {"methods": "raw,shrink:0.5,reflex", "cells": "clean,removal_3mm", "episodes": 8}


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    add = command.add_argument
    add(
        "--methods",
        help=f"name[-ablation][:options][@gain],...; also oracle, oracle:clean; default {METHODS}",
    )
    add("--cells", help=f"conditions, also scale_0.5, bias_1mm, clean_unverified; default {CELLS}")
    add("--ablations", action="store_true", help="also run the six ablations of dexflex")
    add("--grid", action="store_true", help="also run dexflex by numbers of candidates and evaluations")
    add("--episodes", type=int, help="per method and cell; default 300")
    add("--oracle-episodes", type=int, default=48, help="per cell for oracles, which are slow; default 48")
    add("--controller", type=Path, help="folder of the trained controller; default: the shipped one")
    add("--reference", help="method that all others are tested against; default dexflex")
    add("--tuning", action="store_true", help="on the tuning objects: for choosing gains and settings")
    add("--workers", type=int, default=2, help="worker processes; does not change results; default 2")
    add("--batch", type=int, default=16, help="hands side by side in a worker; default 16")
    add("--group", type=int, default=100, help="episodes run and stored together; default 100")
    add("--output", type=Path, help="folder; default outputs/degraded/{test,tuning}")
    add("--chains", type=Path, default=OUTPUT / "chains", help="folder of goal chains, built where missing")
    add("--no-films", action="store_true", help="do not run an episode again to film it")
    add("--demo", action="store_true", help="a few episodes of methods that need no training")
    return command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    try:
        _run(options)
    except DexFlexError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nInterrupted; finished episodes are kept. The same command continues.", file=sys.stderr)
        return 130
    return 0


def _run(options: argparse.Namespace) -> None:
    # Seconds of imports that --help and a mistyped option need not pay.
    from lerobot_dexflex.evaluation.reach.report import make_result, write_report
    from lerobot_dexflex.evaluation.reach.runner import Benchmark, run
    from lerobot_dexflex.evaluation.reach.tables import markdown

    if options.workers < 0:
        raise DexFlexError(f"`--workers` must not be negative. Got {options.workers}.")
    defaults = DEMO if options.demo else {"methods": METHODS, "cells": CELLS, "episodes": 300}
    chosen = {
        key: value if (value := getattr(options, key)) is not None else default
        for key, default in defaults.items()
    }
    kind = "demo" if options.demo else "tuning" if options.tuning else "test"
    variants = (*ABLATION_METHODS * options.ablations, *GRID_METHODS * options.grid)
    benchmark = Benchmark(
        methods=(*_names(chosen["methods"]), *variants),
        cells=_names(chosen["cells"]),
        output=options.output or OUTPUT / kind,
        chains=options.chains,
        episodes=chosen["episodes"],
        oracle_episodes=options.oracle_episodes,
        controller=options.controller,
        tuning=options.tuning or options.demo,
        group=options.group,
        batch=options.batch,
    )
    print(
        f"{len(benchmark.methods)} methods in {len(benchmark.cells)} cells into {benchmark.output}",
        flush=True,
    )
    store, records = run(benchmark, options.workers)
    result = make_result(benchmark, store, records, options.reference)
    page = write_report(benchmark, result, records, films=not options.no_films)
    print(f"\n{markdown(result)}\n\nReport: {page}")


def _names(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
