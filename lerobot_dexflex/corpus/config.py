"""What `dexflex-corpus` is told, and what of it decides the data."""

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from lerobot_dexflex.corpus.schema import ACQUIRED, OPERATED, TURNED
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand

FIRST_SEED = {"train": 0, "tune": 10_000, "test": 20_000}
"""Seed of the first object of every split. The benchmark's objects begin at 100 000, never used here."""


@dataclass
class Jobs:
    """How many jobs, hence shards, every split gets; more can be asked for later."""

    train: int = 128
    tune: int = 6
    test: int = 6

    def __post_init__(self) -> None:
        for f in fields(self):
            if getattr(self, f.name) < 0:
                raise DexFlexError(f"`jobs.{f.name}` must not be negative. Got {getattr(self, f.name)}.")


@dataclass
class Shares:
    """Shares of the kept control steps."""

    operated: float = 0.65
    """The operator leads the object to goals under spoilt drafts, pushes and slips, with clean stretches."""
    acquired: float = 0.15
    """Taking from a fixture and giving back."""
    turned: float = 0.2
    """Turning what a hinge carries, stroke by stroke with regrasps."""

    def __post_init__(self) -> None:
        shares = list(self.by_kind.values())
        if min(shares) < 0 or abs(sum(shares) - 1.0) > 1e-6:
            raise DexFlexError(f"`shares` must not be negative and must sum to 1. Got {asdict(self)}.")

    @property
    def by_kind(self) -> dict[int, float]:
        """Shares by kind of episode."""
        return {OPERATED: self.operated, ACQUIRED: self.acquired, TURNED: self.turned}


@dataclass
class CorpusConfig:
    """Generate the controller's training data."""

    output: Path = Path("outputs/corpus/reach")
    """Folder of the corpus; must not exist, or must hold a corpus of the same recipe."""
    seed: int = 0
    """Of everything but the objects, whose seeds follow from their split."""
    workers: int = 2
    """Worker processes; 0 works in this process. With `OMP_NUM_THREADS=1` the data do not depend on it."""
    jobs: Jobs = field(default_factory=Jobs)
    objects_per_job: int = 8
    steps_per_object: int = 600
    """Kept control steps per object, on average."""
    shares: Shares = field(default_factory=Shares)
    hand: str = "leap"
    """Whose data: a name of the library, or `package.module:ATTRIBUTE`."""

    def __post_init__(self) -> None:
        get_hand(self.hand)
        if self.seed < 0 or self.workers < 0:
            raise DexFlexError(
                f"`seed` and `workers` must not be negative. Got {self.seed} and {self.workers}."
            )
        if min(self.objects_per_job, self.steps_per_object) < 1:
            raise DexFlexError(
                "`objects_per_job` and `steps_per_object` must be positive. "
                f"Got {self.objects_per_job} and {self.steps_per_object}."
            )
        limit = FIRST_SEED["tune"] - FIRST_SEED["train"], 1000, 1000
        for split, most in zip(FIRST_SEED, limit, strict=True):
            objects = getattr(self.jobs, split) * self.objects_per_job
            if objects > most:
                raise DexFlexError(f"`{split}` may have at most {most} objects. Got {objects}.")
        self.output = Path(self.output)

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain values, ready for YAML."""
        return asdict(self) | {"output": self.output.as_posix()}

    def object_seeds(self, split: str, job: int) -> list[int]:
        """Return the seeds of a job's objects."""
        first = FIRST_SEED[split] + job * self.objects_per_job
        return list(range(first, first + self.objects_per_job))
