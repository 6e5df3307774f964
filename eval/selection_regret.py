"""Try out the candidates of dexflex's decisions in the simulator: what its choice is worth, and what is left.

python eval/selection_regret.py --cells removal_2mm,noise_2mm --episodes 48

Interrupt with Ctrl-C and run the same command again to continue; more cells or episodes extend it.
"""

import argparse
import json
import os
import sys
from pathlib import Path

from lerobot_dexflex.errors import DexFlexError

OUTPUT = Path("outputs/degraded")


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    add = command.add_argument
    add("--cells", default="clean,noise_2mm,delay_2,removal_2mm", help="conditions; default %(default)s")
    add("--episodes", type=int, default=48, help="per cell, rounded up to groups of 8; default 48")
    add("--controller", type=Path, help="folder of a controller; default: the shipped one")
    add("--tuning", action="store_true", help="on the tuning objects")
    add("--workers", type=int, default=2, help="worker processes; does not change results; default 2")
    add("--output", type=Path, default=OUTPUT / "regret", help="folder; default %(default)s")
    add("--chains", type=Path, default=OUTPUT / "chains", help="folder of goal chains, built where missing")
    return command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    from lerobot_dexflex.evaluation.degraded.regret import Judging, judge, markdown
    from lerobot_dexflex.evaluation.degraded.runner import Benchmark

    try:
        benchmark = Benchmark(
            methods=("dexflex",),
            cells=tuple(word.strip() for word in options.cells.split(",")),
            output=options.output,
            chains=options.chains,
            episodes=options.episodes,
            controller=options.controller,
            tuning=options.tuning,
        )
        result = judge(Judging(benchmark), options.workers)
    except DexFlexError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nInterrupted; finished groups are kept. The same command continues.", file=sys.stderr)
        return 130
    file = options.output / "selection_regret.json"
    file.write_text(json.dumps(result, indent=2) + "\n")
    print(f"\n{markdown(result)}\n\n{file}")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
