"""What `dexflex-record` is told, and what of it decides the recorded data."""

from dataclasses import dataclass
from typing import ClassVar

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.commands.source import check_source
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import expert_module
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.recording.recipe import Recipe


@dataclass
class RecordConfig(Recipe):
    """Record successful demonstrations of a task's privileged operator as a LeRobotDataset."""

    program: ClassVar[str] = "dexflex-record"
    repeatable: ClassVar[bool] = True
    free: ClassVar[tuple[str, ...]] = (*Recipe.free, "workers", "max_attempts")

    workers: int = 2
    """Worker processes; 0 records in this process. The data do not depend on it."""
    max_attempts: int = 0
    """Give up after so many attempts; 0 means twice the episodes plus 10."""
    glove: str = "clean"
    """What goes wrong with the commands: `clean`, a person's level (`steady`, `typical`, `novice`; attempt k
    is led by the person that `(seed, k)` draws, so a dataset comes from several), errors such as `noise_2mm`,
    or several joined by `+`."""
    source: str = "motion"
    """What a draft says: `motion`, where the fingertips should be, or `pressing`, that and the squeeze."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("workers", "max_attempts"):
            if getattr(self, name) < 0:
                raise DexFlexError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        self.glove = CommandErrors.parse(self.glove).name
        check_drafts(self.source, self.interface)
        if 0 < self.max_attempts < self.episodes:
            raise DexFlexError(
                f"`max_attempts` ({self.max_attempts}) must not be below `episodes` ({self.episodes}); "
                "0 chooses twice the episodes plus 10."
            )

    @property
    def modules(self) -> tuple[str, ...]:
        """Modules whose source decides what an episode contains, with all that they import."""
        return (*super().modules, expert_module(self.task))

    @property
    def attempt_limit(self) -> int:
        """Attempts after which recording gives up."""
        return self.max_attempts or 2 * self.episodes + 10


def check_drafts(source: str, interface: str) -> None:
    """Refuse a source of drafts that is none, or that the interface does not read.

    Raises:
        DexFlexError: If so.
    """
    if check_source(source) == "pressing" and Method.parse(interface).command_space == "joint":
        raise DexFlexError(
            f"`source` says what drafts hold, but the interface {interface!r} reads none. Leave it "
            "out, or choose an interface that reads drafts, such as --interface=raw."
        )
