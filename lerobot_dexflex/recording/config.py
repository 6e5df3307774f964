"""What `dexflex-record` is told, and what of it decides the recorded data."""

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.source import check_source
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import expert_module
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.recording.repo import check_repo_id
from lerobot_dexflex.runs.provenance import weights_digest


@dataclass
class VideoConfig:
    """h264 settings of the two cameras (yuv420p, preset `slow`); small enough to commit 50 demonstrations."""

    crf: int = 28
    """Constant rate factor: 0 is lossless, 51 is worst; 18 to 23 look the same at 96 pixels."""
    gop: int = 40
    """Frames from one key frame to the next; small values make random access cheap and files large."""

    def __post_init__(self) -> None:
        if not 0 <= self.crf <= 51:
            raise DexFlexError(f"`video.crf` must be in [0, 51]. Got {self.crf}.")
        if self.gop < 1:
            raise DexFlexError(f"`video.gop` must be at least 1. Got {self.gop}.")


@dataclass
class RecordConfig:
    """Record successful demonstrations of a task's privileged operator as a LeRobotDataset."""

    task: str = "PlaceHammer-v0"
    """Task to demonstrate."""
    episodes: int = 50
    """Successful episodes to keep."""
    seed: int = 0
    """Attempt k starts from environment seed `seed + k`; its noise is drawn from `(seed, k)`."""
    root: Path = Path("outputs/recording")
    """Folder of the dataset; must not exist, or must hold an unfinished recording of the same recipe."""
    repo_id: str = ""
    """Name on the Hub, one that it allows; empty means `lerobot-dexflex/<name of the root folder>`."""
    workers: int = 2
    """Worker processes; 0 records in this process. The data do not depend on it."""
    max_attempts: int = 0
    """Give up after so many attempts; 0 means twice the episodes plus 10."""
    interface: str = "joint"
    """What executes the operator's commands while recording, and so makes the labels: `joint`, its own joints
    bit for bit, or a method that reads its draft (`raw`, `press`, `dexgen`, `dexflex`, ...)."""
    glove: str = "clean"
    """What goes wrong with the commands: `clean`, a person's level (`steady`, `typical`, `novice`; attempt k
    is led by the person that `(seed, k)` draws, so a dataset comes from several), errors such as `noise_2mm`,
    or several joined by `+`."""
    source: str = "motion"
    """What a draft says: `motion`, where the fingertips should be, or `pressing`, that and the squeeze."""
    controller: str = ""
    """Folder or hub id of the controller of `dexgen` and `dexflex`; empty is the repository's own."""
    video: VideoConfig = field(default_factory=VideoConfig)
    """Encoding of the cameras."""
    push: bool = False
    """Upload the finished dataset to the Hub under `repo_id`; `--push` is short for `--push=true`."""
    push_dry_run: Path | None = None
    """Upload nothing, but build what would be uploaded in `<this folder>/<repo_id>`, offline, and list it."""

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise DexFlexError(f"Unknown task {self.task!r}. Valid tasks: {', '.join(TASKS)}.")
        if self.episodes < 1:
            raise DexFlexError(f"`episodes` must be at least 1. Got {self.episodes}.")
        for name in ("seed", "workers", "max_attempts"):
            if getattr(self, name) < 0:
                raise DexFlexError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        self.glove = CommandErrors.parse(self.glove).name
        if check_source(self.source) == "pressing" and Method.parse(self.interface).command_space == "joint":
            raise DexFlexError(
                f"`source` says what drafts hold, but the interface {self.interface!r} reads none. Leave it "
                "out, or choose an interface that reads drafts, such as --interface=raw."
            )
        if 0 < self.max_attempts < self.episodes:
            raise DexFlexError(
                f"`max_attempts` ({self.max_attempts}) must not be below `episodes` ({self.episodes}); "
                "0 chooses twice the episodes plus 10."
            )
        self.root = Path(self.root)
        if not self.root.resolve().name:
            raise DexFlexError(f"`root` must be a folder with a name. Got {self.root}.")
        if not self.repo_id:
            self.repo_id = f"lerobot-dexflex/{self.root.resolve().name}"
        check_repo_id(self.repo_id)

    @property
    def controller_digest(self) -> str:
        """Content hash of the interface's controller; empty if it needs none.

        Raises:
            DexFlexError: If it is not there.
        """
        weights = Method.parse(self.interface).weights(self.controller)
        return weights_digest(weights) if weights else ""

    @property
    def modules(self) -> tuple[str, ...]:
        """Modules whose source decides what an episode contains, with all that they import."""
        task, interface = TASKS[self.task].module, Method.parse(self.interface).modules
        return ("lerobot_dexflex.recording.attempt", task, expert_module(self.task), *interface)

    @property
    def attempt_limit(self) -> int:
        """Attempts after which recording gives up."""
        return self.max_attempts or 2 * self.episodes + 10

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain values, ready for YAML: who records it again need not upload it."""
        values = asdict(self) | {"root": self.root.as_posix()}
        return {name: value for name, value in values.items() if name not in _AFTERWARDS}


_AFTERWARDS = ("push", "push_dry_run")
_FREE = ("episodes", "root", "repo_id", "workers", "max_attempts", *_AFTERWARDS)


def identity(config: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of `RecordConfig.to_dict()` on which each recorded episode depends."""
    values = RecordConfig().to_dict() | config
    return {f.name: values[f.name] for f in fields(RecordConfig) if f.name not in _FREE}
