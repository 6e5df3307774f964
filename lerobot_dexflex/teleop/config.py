"""What `dexflex-teleop` is told."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import expert_module
from lerobot_dexflex.recording.config import check_drafts
from lerobot_dexflex.recording.recipe import SIMULATED, Recipe
from lerobot_dexflex.teleop.stream_config import STREAMS, LeadConfig, StreamConfig

SOURCES = (*STREAMS, SIMULATED)
VIEWS = ("rerun", "none")


@dataclass
class SimulatedConfig:
    """The task's expert in a person's place, as in `dexflex-record`."""

    glove: str = "typical"
    """What goes wrong with the commands; see `RecordConfig`."""
    source: str = "motion"
    """What a draft says; see `RecordConfig`."""

    def __post_init__(self) -> None:
        self.glove = CommandErrors.parse(self.glove).name


@dataclass
class TeleopConfig(LeadConfig, Recipe):
    """Operate the hand live, look at it, and record a LeRobotDataset by key."""

    program: ClassVar[str] = "dexflex-teleop"
    repeatable: ClassVar[bool] = False
    free: ClassVar[tuple[str, ...]] = (
        *Recipe.free,
        "stream",
        *LeadConfig.__dataclass_fields__,
        "hands_free",
        "time_limit",
        "realtime",
        "view",
        "view_folder",
    )

    root: Path = Path("outputs/teleop")
    """Folder of the dataset. Attempts are safe in `<root>.partial` as soon as they are kept or discarded; the
    dataset is written at the end, and the same command goes on with it."""
    interface: str = "dexflex"
    """What executes the person's commands: a method that reads drafts (`dexflex`, `raw`, `press`, ...), or
    `joint`, the joints of the inverse kinematics."""
    source: str = SIMULATED
    """Who leads: `rokoko`, `openxr` or `mediapipe` by UDP, `replay` of a stored stream, or `simulated`, the
    task's expert with a person's errors."""
    stream: StreamConfig = field(default_factory=StreamConfig)
    """How the stream comes and is read."""
    simulated: SimulatedConfig = field(default_factory=SimulatedConfig)
    """Who the simulated person is."""
    hands_free: bool = False
    """Begin episodes by themselves, keep those that succeed, discard the others; of `simulated` always."""
    time_limit: float = 60.0
    """Longest episode [s]; 0 sets none."""
    realtime: bool = True
    """Whether time passes as on the wall; without, as fast as the machine can, for `replay`, `simulated`."""
    view: str = "rerun"
    """`rerun`: the viewer, or without a display one recording per episode in `view_folder`; `none`."""
    view_folder: Path | None = None
    """Where recordings for rerun go, also with a display; empty means `<root>.rerun` if there is none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, valid in (("source", SOURCES), ("view", VIEWS)):
            if getattr(self, name) not in valid:
                raise DexFlexError(
                    f"`{name}` must be one of {', '.join(valid)}. Got {getattr(self, name)!r}."
                )
        if self.source == SIMULATED:
            expert_module(self.task)
            check_drafts(self.simulated.source, self.interface)
            self.hands_free = True
        self._check_arm()
        self.stream.check(self.source)
        self.check_lead()
        if not 0 <= self.time_limit < math.inf:
            raise DexFlexError(f"`time_limit` must not be negative; 0 sets none. Got {self.time_limit}.")
        if not self.realtime and self.source not in ("replay", SIMULATED):
            raise DexFlexError(f"`realtime` must be true for {self.source}: a person cannot be hurried.")
        if self.view == "none" and self.view_folder is not None:
            raise DexFlexError("`view_folder` is for --view=rerun. Got --view=none: leave one out.")

    def _check_arm(self) -> None:
        if not TASKS[self.task].arm:
            valid = [name for name, task in TASKS.items() if task.arm]
            raise DexFlexError(f"{self.task} has no arm to lead. Valid tasks: {', '.join(valid)}.")
