"""Search the contact projection's settings at random, on training objects, and say what each is worth.

python eval/search_projection.py --trials 200

Interrupt with Ctrl-C and run the same command again to continue; more trials extend it.
"""

import argparse
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
    add("--trials", type=int, default=200, help="settings to draw, 16 episodes each; default 200")
    add("--chains-per-search", type=int, default=250, help="starts to draw from; default 250")
    add("--controller", type=Path, help="folder of a controller; default: the shipped one")
    add("--workers", type=int, default=2, help="worker processes; does not change results; default 2")
    add("--output", type=Path, default=OUTPUT / "search", help="folder; default outputs/degraded/search")
    add("--chains", type=Path, default=OUTPUT / "chains", help="folder of goal chains, built where missing")
    return command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    from lerobot_dexflex.evaluation.reach.search import Search, fit, run_search

    search = Search(options.output, options.chains, options.chains_per_search, options.controller)
    try:
        trials = run_search(search, options.trials, options.workers)
        effects = fit(trials)
    except DexFlexError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nInterrupted; finished trials are kept. The same command continues.", file=sys.stderr)
        return 130
    episodes = [value for trial in trials for value in trial.progress]
    print(
        f"\n{len(trials)} trials, {len(episodes)} episodes, mean progress {sum(episodes) / len(episodes):.3f}"
    )
    print("\n| setting | half the range is worth | best |\n| --- | --- | --- |")
    for effect in effects:
        print(f"| {effect.name} | {effect.slope:+.3f} ± {effect.error:.3f} | {effect.best:.4g} |")
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
