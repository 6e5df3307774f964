"""Compare action interfaces on the same episodes: tables, tests, and a report with films.

python eval/compare_interfaces.py --tasks=PlaceHammer-v0 --methods=joint,raw,dexflex --episodes=100

Interrupt with Ctrl-C and run the same command again to continue. More tasks, methods, conditions or episodes
extend what is there; only rows whose method changed run again.
"""

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lerobot_dexflex import console
from lerobot_dexflex.commands.source import check_source, operator_label
from lerobot_dexflex.console import names
from lerobot_dexflex.conventions import COMMANDED, DRAFTS
from lerobot_dexflex.envs.registration import check_tasks
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand

_ROOT = Path(__file__).resolve().parents[1]
_CHECKPOINTS = Path("policies/checkpoints")
EPISODES, VIDEOS = 100, 4
DEMO_EPISODES, DEMO_VIDEOS = 12, 2
"""Chosen so that three interfaces take less than five minutes on two cores."""


@dataclass
class Config:
    """Compare action interfaces on the same episodes of tasks, under policies or the privileged operator."""

    tasks: str = "PlaceHammer-v0"
    """Names of tasks, separated by commas."""
    methods: str = "joint,raw,press"
    """`name[-ablation][:options][@gain],...`, such as `raw,dexgen@0.4,dexflex-notouch`."""
    hand: str = "leap"
    """The hand: a name of `lerobot_dexflex.hands`."""
    conditions: str = "clean"
    """What goes wrong, separated by commas: a person's level, errors of commands and disturbances, such as
    `clean,typical,noise_4mm,removal_2mm+heavy`."""
    episodes: int = 0
    """Per task, method and condition; 0 means 100, or 12 with `demo`."""
    seed: int = 100_000
    """Episode i starts from environment seed `seed + i`; the default and above are held out."""
    policy: Path | None = None
    """Folder `pretrained_model` of the policy under all interfaces; default: the task's shipped one."""
    draft: str = ""
    """Which of the policy's fingertips interfaces that read drafts execute: `measured` or `commanded`.
    Empty leaves it to the policy: measured ones if it learned them."""
    policies: str = ""
    """`METHOD=FOLDER,...`: methods' own checkpoints, e.g. trained on what was recorded through them."""
    backbone: Path | None = None
    """Folder `pretrained_model` of ACT or another policy of LeRobot, under all interfaces, instead."""
    operator: bool = False
    """No policy: the privileged operator teleoperates the hand through the interfaces; `joint`
    executes its own joints."""
    source: str = "motion"
    """What the operator's drafts say: `motion`, where the fingertips should be, or `pressing`, that and the
    squeeze."""
    controller: str = ""
    """Folder or hub id of the controller of dexgen and dexflex; default: the shipped one."""
    label: str = ""
    """Goes before the methods' names in the table, to tell policies apart: `act` leaves rows of `act/raw`.
    Empty: nothing, `operator`, `operator-pressing`, the kind of the `backbone`, or `commanded` with
    `draft=commanded`."""
    device: str = "cpu"
    """Torch device of the policies."""
    workers: int = 2
    """Worker processes; 0 runs in this one. Rows do not depend on it."""
    batch_size: int = 1
    """Episodes in lock-step in a worker; decides the last bits."""
    output: Path = Path("outputs/compare")
    """Folder of the rows and the report; `eval/results` publishes them."""
    videos: int = -1
    """Film the first so many episodes; -1 means 4, or 2 with `demo`."""
    rerun: bool = False
    """Also log the filmed episodes as `.rrd` for rerun."""
    demo: bool = False
    """Run a few episodes, within five minutes on two cores."""

    def __post_init__(self) -> None:
        check_tasks(names(self.tasks))
        get_hand(self.hand)
        for name in ("workers", "episodes", "seed"):
            if getattr(self, name) < 0:
                raise DexFlexError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        if self.draft not in ("", *DRAFTS):
            raise DexFlexError(f"`draft` must be {' or '.join(DRAFTS)}. Got {self.draft!r}.")
        ours = any((self.policy, self.draft, self.policies))
        if ours + (self.backbone is not None) + self.operator > 1:
            raise DexFlexError(
                "Give one of --operator, --backbone, or our policies: --policy, --draft and --policies."
            )
        if check_source(self.source) == "pressing" and not self.operator:
            raise DexFlexError("`source` says what the operator's drafts hold. Give --operator=true as well.")
        if (self.policy or self.policies or self.backbone) and len(names(self.tasks)) > 1:
            raise DexFlexError(f"A policy learned one task. Give one of --tasks={self.tasks}, or no policy.")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    return console.run(Config, _work, arguments)


def _work(config: Config, words: list[str]) -> int:
    # Seconds of imports that --help and a mistyped option need not pay.
    from lerobot_dexflex.evaluation.comparison import compare

    comparison = build(config)
    print(f"{', '.join(comparison.methods)} into {comparison.table}", flush=True)
    rows = compare(comparison, config.workers)
    from lerobot_dexflex.evaluation.report.page import write_report

    text, page = write_report(comparison, rows)
    print(f"\n{text}\n\nReport: {page}")
    if config.rerun:
        print(f"Recordings: rerun {comparison.output}/rerun/**/*.rrd")
    if config.demo:
        print(f"Next: {next_command(words)}")
    return 0


def build(config: Config) -> Any:
    """Return the comparison that a configuration describes.

    Raises:
        DexFlexError: If a method, a condition or a checkpoint does not exist or does not fit.
    """
    from lerobot_dexflex.evaluation.comparison import Comparison
    from lerobot_dexflex.interfaces.method import Method

    episodes, videos = (DEMO_EPISODES, DEMO_VIDEOS) if config.demo else (EPISODES, VIDEOS)
    return Comparison(
        players={task: players(config, task) for task in names(config.tasks)},
        methods=tuple(Method.parse(name).name for name in names(config.methods)),
        output=config.output,
        conditions=names(config.conditions),
        seeds=range(config.seed, config.seed + (config.episodes or episodes)),
        batch_size=config.batch_size,
        label=label(config),
        cameras=not config.operator,
        videos=videos if config.videos < 0 else config.videos,
        rerun=config.rerun,
    )


def players(config: Config, task: str) -> Any:
    """Return who acts on a task: our policies, any policy of LeRobot, or the privileged operator."""
    from lerobot_dexflex.evaluation.policies import AdaptedPolicies, LeRobotPolicies
    from lerobot_dexflex.evaluation.teleoperators import Teleoperators

    hand = get_hand(config.hand)
    if config.operator:
        return Teleoperators(hand, task, config.controller, check_source(config.source))
    if config.backbone is not None:
        return AdaptedPolicies(hand, config.backbone, config.device, config.controller)
    return LeRobotPolicies(
        hand=hand,
        policy=config.policy or shipped(task),
        draft=config.draft,
        device=config.device,
        controller=config.controller,
        own=own_policies(names(config.policies)),
    )


def label(config: Config) -> str:
    """Return what goes before the methods' names."""
    if config.label or not (config.operator or config.backbone):
        return config.label or (COMMANDED if config.draft == COMMANDED else "")
    if config.operator:
        return operator_label(check_source(config.source))
    from lerobot_dexflex.evaluation.checkpoints import policy_type

    assert config.backbone is not None
    return policy_type(config.backbone)


def own_policies(words: Sequence[str]) -> tuple[tuple[str, Path], ...]:
    """Parse `METHOD=FOLDER`.

    Raises:
        DexFlexError: If a word looks different, names no method, or one a second time.
    """
    from lerobot_dexflex.interfaces.method import Method

    found: dict[str, Path] = {}
    for word in words:
        name, equals, folder = word.rpartition("=")
        if not (equals and name and folder):
            raise DexFlexError(f"`policies` must look like dexflex=<folder>,raw=<folder>. Got {word!r}.")
        if Method.parse(name).name in found:
            raise DexFlexError(f"`policies` holds {name} twice.")
        found[Method.parse(name).name] = Path(folder)
    return tuple(found.items())


def shipped(task: str) -> Path:
    """Return the checkpoint that comes with the repository: PlaceHammer-v0 -> place_hammer."""
    words = "".join(f"_{c.lower()}" if c.isupper() else c for c in task.split("-")[0]).strip("_")
    return _ROOT / _CHECKPOINTS / words


def next_command(words: list[str]) -> str:
    """Return the command that extends the demo to the full comparison, re-using its episodes."""
    python = Path(sys.executable)
    local = python.relative_to(Path.cwd()) if python.is_relative_to(Path.cwd()) else python
    kept = [word for word in words if word != "--demo=true"]
    return shlex.join([str(local), "eval/compare_interfaces.py", *kept, f"--episodes={EPISODES}"])


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
