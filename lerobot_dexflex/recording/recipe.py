"""What every way to record is told: of which task, through which interface, into which dataset."""

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

from lerobot_dexflex.envs.registration import TASKS, check_tasks
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.recording.repo import check_repo_id
from lerobot_dexflex.runs.provenance import weights_digest

SIMULATED = "simulated"
"""Who leads a live operation if no person does, and the part of its recipe that says how."""


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
class Recipe:
    """A dataset to record. Subclasses say how; all is checked when it is made.

    Raises:
        DexFlexError: If a value cannot be right.
    """

    program: ClassVar[str]
    """The console script that records."""
    repeatable: ClassVar[bool]
    """Whether recipe and code decide every episode; then only the same code may go on with a recording."""
    free: ClassVar[tuple[str, ...]] = ("episodes", "root", "repo_id")
    """Fields that do not change what an episode is; a recording may go on with others."""
    afterwards: ClassVar[tuple[str, ...]] = ("push", "push_dry_run")
    """Fields of what happens to the finished dataset; not stored with it."""

    task: str = "PlaceHammer-v0"
    """Task to demonstrate."""
    hand: str = "leap"
    """Hand that does it: a name of `lerobot_dexflex.hands`."""
    episodes: int = 50
    """Episodes to keep."""
    seed: int = 0
    """Attempt k starts from environment seed `seed + k`; its noise, if any, is drawn from `(seed, k)`."""
    root: Path = Path("outputs/recording")
    """Folder of the dataset; must not exist, or must hold an unfinished recording of the same recipe."""
    repo_id: str = ""
    """Name on the Hub, one that it allows; empty means `lerobot-dexflex/<name of the root folder>`."""
    interface: str = "joint"
    """What executes the operator's commands while recording, and so makes the labels: `joint`, its own joints
    bit for bit, or a method that reads its draft (`raw`, `press`, `dexgen`, `dexflex`, ...)."""
    controller: str = ""
    """Folder or hub id of the controller of `dexgen` and `dexflex`; empty is the repository's own."""
    video: VideoConfig = field(default_factory=VideoConfig)
    """Encoding of the cameras."""
    push: bool = False
    """Upload the finished dataset to the Hub under `repo_id`; `--push` is short for `--push=true`."""
    push_dry_run: Path | None = None
    """Upload nothing, but build what would be uploaded in `<this folder>/<repo_id>`, offline, and list it."""

    def __post_init__(self) -> None:
        check_tasks([self.task])
        get_hand(self.hand)
        if self.episodes < 1:
            raise DexFlexError(f"`episodes` must be at least 1. Got {self.episodes}.")
        if self.seed < 0:
            raise DexFlexError(f"`seed` must not be negative. Got {self.seed}.")
        Method.parse(self.interface)
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
        weights = Method.parse(self.interface).weights(get_hand(self.hand), self.controller)
        return weights_digest(weights) if weights else ""

    @property
    def modules(self) -> tuple[str, ...]:
        """Modules whose source decides what an episode contains, with all that they import."""
        task, interface = TASKS[self.task].module, Method.parse(self.interface).modules
        return ("lerobot_dexflex.recording.attempt", task, *interface)

    def to_dict(self) -> dict[str, Any]:
        """Return the recipe as plain values, ready for YAML: who records it again need not upload it."""
        return {name: _plain(value) for name, value in asdict(self).items() if name not in self.afterwards}

    @classmethod
    def identity(cls, recipe: dict[str, Any]) -> dict[str, Any]:
        """Return the entries of a `to_dict()`, also of an earlier version, on which each episode depends."""
        values = cls().to_dict() | recipe
        return {name: values[name] for name in values if name in cls._deciding()}

    @classmethod
    def _deciding(cls) -> set[str]:
        return {f.name for f in fields(cls)} - {*cls.free, *cls.afterwards}


def _plain(value: Any) -> Any:
    """Return a value without paths."""
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return value.as_posix() if isinstance(value, Path) else value
