"""What `dexflex-corpus` is told, and what of it decides the data."""

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from lerobot_dexflex.corpus.schema import ACQUIRED, FAILED, INTERFACED, OPERATED, SEARCH, SOURCES
from lerobot_dexflex.errors import DexFlexError

FIRST_SEED = {"train": 0, "tune": 10_000, "test": 20_000}
"""Seed of the first object of every split. The benchmark's objects begin at 100 000, never used here."""
STAGES = ("corpus", "replays")


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

    search: float = 0.35
    """Search expert: chains of goals, replayed without its failures."""
    operated: float = 0.45
    """Operator under corrupted commands, pushes and slips, with clean stretches."""
    acquired: float = 0.10
    """Taking from a fixture and giving back."""
    interfaced: float = 0.0
    """Like `operated`, executed by an interface (DAgger)."""
    failed: float = 0.10
    """Branches that the search gave up."""

    def __post_init__(self) -> None:
        shares = list(self.by_kind.values())
        if min(shares) < 0 or abs(sum(shares) - 1.0) > 1e-6:
            raise DexFlexError(f"`shares` must not be negative and must sum to 1. Got {asdict(self)}.")

    @property
    def by_kind(self) -> dict[int, float]:
        """Shares by kind of episode."""
        return {
            SEARCH: self.search,
            OPERATED: self.operated,
            ACQUIRED: self.acquired,
            INTERFACED: self.interfaced,
            FAILED: self.failed,
        }


@dataclass
class Replays:
    """What `--stage=replays` plays back."""

    per_shard: int = 800
    """Replays of one shard; snapshots are drawn from all that are left in it."""
    expert: float = 0.25
    prior: float = 0.25
    perturbed: float = 0.3
    draft_seeded: float = 0.2

    def __post_init__(self) -> None:
        shares = self.shares
        if min(shares) < 0 or abs(sum(shares) - 1.0) > 1e-6:
            raise DexFlexError(
                f"The shares of `replays` must not be negative and must sum to 1. Got {shares}."
            )

    @property
    def shares(self) -> tuple[float, ...]:
        """Shares in the order of `schema.SOURCES`."""
        return tuple(getattr(self, source.replace("-", "_")) for source in SOURCES)


@dataclass
class CorpusConfig:
    """Generate the controller's training data, or replays of what it holds."""

    stage: str = "corpus"
    """`corpus` or `replays`; replays read the finished corpus in `output`."""
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
    interface: str = ""
    """Interface that executes the episodes of kind 3; empty if there are none."""
    controller: str = ""
    """Folder of a trained controller, for the interface and for the replays' proposals."""
    replays: Replays = field(default_factory=Replays)

    def __post_init__(self) -> None:
        if self.stage not in STAGES:
            raise DexFlexError(f"`stage` must be one of {STAGES}. Got {self.stage!r}.")
        if self.seed < 0 or self.workers < 0:
            raise DexFlexError(
                f"`seed` and `workers` must not be negative. Got {self.seed} and {self.workers}."
            )
        if min(self.objects_per_job, self.steps_per_object) < 1:
            raise DexFlexError(
                "`objects_per_job` and `steps_per_object` must be positive. "
                f"Got {self.objects_per_job} and {self.steps_per_object}."
            )
        if bool(self.shares.interfaced) != bool(self.interface):
            raise DexFlexError(
                "`shares.interfaced` and `interface` belong together: name the interface that shall execute, "
                f"or set the share to 0. Got {self.shares.interfaced} and {self.interface!r}."
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


_DECISIVE = {
    "corpus": ("seed", "objects_per_job", "steps_per_object", "shares", "interface", "controller"),
    "replays": ("seed", "controller", "replays"),
}


def identity(config: dict[str, Any], stage: str) -> dict[str, Any]:
    """Return the entries of `CorpusConfig.to_dict()` on which every shard of a stage depends."""
    return {key: config.get(key) for key in _DECISIVE[stage]}
