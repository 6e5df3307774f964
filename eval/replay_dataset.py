"""Replay a recorded dataset through an interface, from the same initial states, beside the expert's rate.

python eval/replay_dataset.py --root datasets/place_hammer --interfaces raw
"""

import argparse
import dataclasses
import os
import shlex
import sys
from pathlib import Path
from typing import Any

from lerobot_dexflex.errors import DexFlexError


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    command.add_argument(
        "--root", type=Path, default=Path("datasets/place_hammer"), help="folder of the dataset"
    )
    command.add_argument("--interfaces", nargs="+", default=["raw"], help="names of interfaces; default raw")
    command.add_argument(
        "--errors",
        default="clean",
        help="what goes wrong with the commands, e.g. jitter_2mm; default clean",
    )
    command.add_argument("--workers", type=int, default=2, help="worker processes; default 2")
    command.add_argument("--output", type=Path, help="also write all outcomes to this JSON file")
    options = command.parse_args(arguments)
    try:
        run(options)
    except DexFlexError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def run(options: argparse.Namespace) -> None:
    """Replay, print the rates, and write the result file."""
    from lerobot_dexflex.commands.families import CommandErrors
    from lerobot_dexflex.evaluation.replay import load_demonstrations, replay
    from lerobot_dexflex.evaluation.store import write_json
    from lerobot_dexflex.interfaces import make_interface
    from lerobot_dexflex.runs.provenance import commit
    from lerobot_dexflex.runs.statistics import success_rate

    errors = CommandErrors.parse(options.errors)
    for name in options.interfaces:
        make_interface(name)
    demonstrations = load_demonstrations(options.root)
    successes, attempts = demonstrations.expert
    expert = success_rate([True] * successes + [False] * (attempts - successes))
    rates = {"expert, all attempts": expert}
    episodes: dict[str, list[dict[str, Any]]] = {}
    for name in options.interfaces:
        outcomes = replay(demonstrations, name, options.workers, errors=errors)
        rates[f"{name}, replayed from its successes"] = success_rate([o.success for o in outcomes])
        episodes[name] = [dataclasses.asdict(o) for o in outcomes]
    for name, rate in rates.items():
        low, high = rate.pc_success_ci95
        interval = f"{rate.pc_success:.0f} %, Wilson {low:.0f}-{high:.0f} %"
        print(f"{name}: {rate.n_success}/{rate.n_episodes} ({interval})")
    if options.output:
        origin = {"command": shlex.join(["python", *sys.argv]), "commit": commit()}
        summary = {name: rate._asdict() for name, rate in rates.items()}
        options.output.parent.mkdir(parents=True, exist_ok=True)
        write_json(options.output, {**origin, "rates": summary, "episodes": episodes})


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
