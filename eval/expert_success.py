"""Measure the scripted expert's success rate on unseen initial states.

python eval/expert_success.py --task PlaceHammer-v0 --episodes 200 --seed 200000
"""

import argparse
import os
import sys
from pathlib import Path

from lerobot_dexflex.errors import DexFlexError


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    command.add_argument("--task", default="PlaceHammer-v0", help="task with an expert")
    command.add_argument("--episodes", type=int, default=200, help="initial states; default 200")
    command.add_argument(
        "--seed", type=int, default=200_000, help="environment seed of the first; default 200000"
    )
    command.add_argument("--workers", type=int, default=2, help="worker processes; default 2")
    command.add_argument("--output", type=Path, help="JSON file; default outputs/expert_<task>.json")
    options = command.parse_args(arguments)
    # Options and help answer at once; the simulator takes seconds to import.
    from lerobot_dexflex.recording.expert_rate import expert_rate

    output = options.output or Path(f"outputs/expert_{options.task}.json")
    try:
        rate = expert_rate(options.task, options.episodes, options.seed, options.workers, output)
    except DexFlexError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\nStopped. Finished attempts are in {output}; the same command continues.", file=sys.stderr)
        return 130
    low, high = rate.pc_success_ci95
    print(
        f"Expert of {options.task}: {rate.n_success}/{rate.n_episodes} "
        f"({rate.pc_success:.1f} %, Wilson 95 % {low:.1f}-{high:.1f} %); outcomes in {output}"
    )
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
