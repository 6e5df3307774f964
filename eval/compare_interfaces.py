"""Compare action interfaces on the same episodes: table, tests, and a report with videos.

python eval/compare_interfaces.py --task PlaceHammer-v0 --interfaces joint raw filter --episodes 100

Interrupt with Ctrl-C and run the same command again to continue; a larger --episodes extends a comparison.
"""

import argparse
import dataclasses
import os
import shlex
import sys
from pathlib import Path
from typing import Any

from lerobot_dexflex.envs.registration import NAMESPACE, TASKS
from lerobot_dexflex.errors import DexFlexError

_ROOT = Path(__file__).resolve().parents[1]
_CHECKPOINTS = Path("policies/checkpoints")
DEMO_EPISODES, DEMO_VIDEOS = 12, 2
"""Chosen so that three interfaces take less than five minutes on two cores."""


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    add = command.add_argument
    add("--task", default="PlaceHammer-v0", help="one of " + ", ".join(TASKS))
    add("--interfaces", nargs="+", default=["joint", "raw", "filter"], help="default: joint raw filter")
    add("--episodes", type=int, help=f"episodes per interface; default 100, {DEMO_EPISODES} with --demo")
    add("--seed", type=int, default=100_000, help="episode i uses seed SEED + i; default 100000 (held out)")
    add(
        "--disturbance",
        default="none",
        help="heavy, slippery, pushed, late_touch, miscalibrated; default none",
    )
    add("--command-noise", type=float, default=0.0, help="half width of noise on commanded fingertips [m]")
    add(
        "--command-removal",
        type=float,
        default=0.0,
        help="now and then the most loaded finger is sent off the object, so fast [m per step]",
    )
    add("--joint-policy", type=Path, help="folder pretrained_model; default: the shipped checkpoint")
    add("--draft-policy", type=Path, help="the same for all interfaces that read drafts")
    add(
        "--policy",
        action="append",
        default=[],
        metavar="INTERFACE=FOLDER",
        help="this interface's own checkpoint, e.g. trained on what was recorded through it; repeatable",
    )
    add("--backbone", type=Path, help="folder pretrained_model of ACT or another policy of LeRobot instead")
    add("--controller", default="", help="folder or hub id, for dexgen and dexflex; default: the shipped one")
    add(
        "--operator",
        action="store_true",
        help="no policy: the scripted, privileged expert teleoperates the hand through the interfaces",
    )
    add("--device", default="cpu", help="torch device of the policies; default cpu")
    add("--workers", type=int, default=2, help="worker processes; does not change results; default 2")
    add("--batch-size", type=int, default=1, help="episodes in lock-step per worker; default 1")
    add("--output", type=Path, help="default: outputs/compare/TASK-<hash of all settings>")
    add("--videos", type=int, help=f"film the first so many episodes; default 4, {DEMO_VIDEOS} with --demo")
    add("--rerun", action="store_true", help="also log the filmed episodes as .rrd for `rerun`")
    add("--demo", action="store_true", help="a few episodes, within five minutes on two cores")
    return command


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    try:
        comparison = build(options)
        result, report = run(comparison, options.workers)
    except DexFlexError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nInterrupted; finished episodes are kept. The same command continues.", file=sys.stderr)
        return 130
    from lerobot_dexflex.evaluation.report.table import markdown

    print(f"\n{markdown(result)}\n\nReport: {report}")
    if options.rerun:
        print(f"Recordings: rerun {comparison.output}/rerun/0000_*.rrd")
    if options.demo:
        print(f"Next: {next_command(sys.argv[1:] if arguments is None else arguments)}")
    return 0


def build(options: argparse.Namespace) -> Any:
    """Return the comparison that the options describe.

    Raises:
        DexFlexError: If the task, an interface or a checkpoint does not exist or does not fit.
    """
    from lerobot_dexflex.evaluation.comparison import Comparison
    from lerobot_dexflex.evaluation.provenance import identity_digest
    from lerobot_dexflex.interfaces import Method

    if options.task not in TASKS:
        raise DexFlexError(f"Unknown task {options.task!r}. Valid tasks: {', '.join(TASKS)}.")
    for name in options.interfaces:
        Method.parse(name)
    if options.workers < 0:
        raise DexFlexError(f"`--workers` must not be negative. Got {options.workers}.")
    episodes, videos = (DEMO_EPISODES, DEMO_VIDEOS) if options.demo else (100, 4)
    comparison = Comparison(
        env_id=f"{NAMESPACE}/{options.task}",
        interfaces=tuple(options.interfaces),
        policies=commander(options),
        output=options.output or Path(),
        episodes=episodes if options.episodes is None else options.episodes,
        seed=options.seed,
        batch_size=options.batch_size,
        videos=videos if options.videos is None else options.videos,
        disturbance=options.disturbance,
        rerun=options.rerun,
    )
    if options.output is None:
        name = f"{options.task}-{identity_digest(comparison.identity())}"
        comparison = dataclasses.replace(comparison, output=Path("outputs/compare") / name)
    return comparison


def commander(options: argparse.Namespace) -> Any:
    """Return who commands the interfaces: our policies, any policy of LeRobot, or the scripted operator.

    Raises:
        DexFlexError: If more than one is asked for.
    """
    from lerobot_dexflex.evaluation.command_errors import CommandErrors
    from lerobot_dexflex.evaluation.operators import Operators
    from lerobot_dexflex.evaluation.policies import AdaptedPolicies, LeRobotPolicies

    errors = CommandErrors(options.command_noise, options.command_removal)
    ours = any((options.joint_policy, options.draft_policy, options.policy))
    if ours + (options.backbone is not None) + options.operator > 1:
        raise DexFlexError(
            "Give one of --operator, --backbone, which serves all interfaces, or --joint-policy, "
            "--draft-policy and --policy."
        )
    if options.operator:
        return Operators(options.task, options.controller, errors)
    if options.backbone is not None:
        return AdaptedPolicies(options.backbone, options.device, options.controller, errors)
    return LeRobotPolicies(
        joint=options.joint_policy or shipped(options.task, "joint"),
        draft=options.draft_policy or shipped(options.task, "draft"),
        device=options.device,
        controller=options.controller,
        errors=errors,
        own=own_policies(options.policy),
    )


def own_policies(words: list[str]) -> tuple[tuple[str, Path], ...]:
    """Parse `INTERFACE=FOLDER`.

    Raises:
        DexFlexError: If a word looks different, names no interface, or one a second time.
    """
    from lerobot_dexflex.interfaces import Method

    found: dict[str, Path] = {}
    for word in words:
        name, equals, folder = word.partition("=")
        if not (equals and folder):
            raise DexFlexError(f"`--policy` must look like dexflex=<folder pretrained_model>. Got {word!r}.")
        Method.parse(name)
        if name in found:
            raise DexFlexError(f"`--policy` is given twice for {name}: {found[name]} and {folder}.")
        found[name] = Path(folder)
    return tuple(found.items())


def shipped(task: str, space: str) -> Path:
    """Return the checkpoint that comes with the repository: PlaceHammer-v0 -> place_hammer_joint."""
    words = "".join(f"_{c.lower()}" if c.isupper() else c for c in task.split("-")[0]).strip("_")
    return _ROOT / _CHECKPOINTS / f"{words}_{space}"


def run(comparison: Any, workers: int) -> tuple[dict[str, Any], Path]:
    """Run the comparison and write its report; returns the result and the report's path."""
    from lerobot_dexflex.evaluation.comparison import compare
    from lerobot_dexflex.evaluation.report.page import write_report

    count = comparison.episodes * len(comparison.interfaces)
    print(f"{count} episodes ({', '.join(comparison.interfaces)}) into {comparison.output}", flush=True)
    result, outcomes = compare(comparison, workers)
    return result, write_report(result, outcomes, comparison.output, comparison.videos)


def next_command(arguments: list[str]) -> str:
    """Return the command that extends the demo to the full comparison, re-using its episodes."""
    python = Path(sys.executable)
    local = python.relative_to(Path.cwd()) if python.is_relative_to(Path.cwd()) else python
    kept = [word for word in arguments if word != "--demo"]
    return shlex.join([str(local), "eval/compare_interfaces.py", *kept, "--episodes", "100"])


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
