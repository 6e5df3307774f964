"""Run methods on the same episodes of tasks, under conditions; every episode leaves a row."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from lerobot_dexflex.envs.registration import NAMESPACE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.conditions import CLEAN, IN_HAND, Condition
from lerobot_dexflex.evaluation.outcome import COLUMNS
from lerobot_dexflex.evaluation.rollout import Players, Watcher, run_job
from lerobot_dexflex.runs.jobs import Job, run_missing
from lerobot_dexflex.runs.provenance import Version
from lerobot_dexflex.runs.table import Row

TABLE = "tasks.csv"


@dataclass(frozen=True)
class Comparison:
    """A paired comparison of methods.

    Raises:
        DexFlexError: If a name stands there twice, a condition means nothing here, or a number is out of its
            range.
    """

    players: Mapping[str, Players]
    """Who acts, by the task's name in `TASKS`."""
    methods: tuple[str, ...]
    output: Path
    """Folder of the results; others' rows in it stay."""
    conditions: tuple[str, ...] = (CLEAN,)
    seeds: Sequence[int] = field(default=range(100_000, 100_100))
    """Of the environment, one per episode; they also seed noise of policies and errors of commands."""
    batch_size: int = 1
    """Episodes that run in lock-step; decides them, because batched sums round differently."""
    label: str = ""
    """Goes before the methods' names in the table, to tell policies apart: `act` leaves rows of `act/raw`."""
    cameras: bool = True
    """Whether the players see; without, episodes are faster."""
    videos: int = 0
    """The first so many episodes are filmed while they run."""
    rerun: bool = False
    """Also log the filmed episodes as rerun recordings."""
    namespace: str = NAMESPACE
    """Of the tasks' Gymnasium ids."""

    def __post_init__(self) -> None:
        if self.batch_size < 1:
            raise DexFlexError(f"`batch_size` must be at least 1. Got {self.batch_size}.")
        if len(self.seeds) < 1 or len(self.seeds) % self.batch_size:
            raise DexFlexError(
                f"`episodes` must be at least 1 and fill batches of {self.batch_size}: an episode's numbers "
                f"depend on its whole batch. Got {len(self.seeds)}."
            )
        if min(self.seeds) < 0 or self.videos < 0:
            raise DexFlexError(f"Seeds and `videos` must not be negative. Got {self.seeds}, {self.videos}.")
        for name in ("methods", "conditions"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise DexFlexError(f"`{name}` must be one or more different names. Got {', '.join(values)}.")
        for name in self.conditions:
            _check_condition(name)

    @property
    def table(self) -> Path:
        """The rows, one per episode."""
        return self.output / TABLE

    def named(self, method: str) -> str:
        """Return a method's name in the table."""
        return f"{self.label}/{method}" if self.label else method

    def versions(self) -> dict[tuple[str, str], Version]:
        """Return what decides each method's episodes on each task.

        Raises:
            DexFlexError: If a checkpoint or controller is missing or does not fit.
        """
        batch = {"batch_size": self.batch_size} if self.batch_size > 1 else {}
        if self.batch_size > 1:  # Where batches begin decides who runs together.
            batch["first"] = self.seeds[0] % self.batch_size
        return {
            (task, method): players.version(method, task, **batch)
            for task, players in self.players.items()
            for method in self.methods
        }

    def jobs(self, versions: Mapping[tuple[str, str], Version]) -> list[Job]:
        """Return what is to run, the methods of a batch side by side."""
        size = self.batch_size
        return [
            Job(self.named(method), versions[task, method].name, task, condition, tuple(seeds))
            for task in self.players
            for condition in self.conditions
            for seeds in (self.seeds[k : k + size] for k in range(0, len(self.seeds), size))
            for method in self.methods
        ]

    def run_job(self, job: Job) -> list[Row]:
        """Run the episodes of a job."""
        method = job.method.removeprefix(f"{self.label}/")
        filmed = set(self.seeds[: self.videos])
        watchers = {k: self._watchers(job, seed) for k, seed in enumerate(job.seeds) if seed in filmed}
        recorders = run_job(
            self.players[job.task],
            method,
            f"{self.namespace}/{job.task}",
            Condition.parse(job.condition),
            job.seeds,
            watchers,
            self.cameras,
        )
        outcomes = [r.outcome(job.method, seed) for r, seed in zip(recorders, job.seeds, strict=True)]
        for row, row_watchers in watchers.items():
            for watcher in row_watchers:
                watcher.close(outcomes[row])
        return [outcome.row() for outcome in outcomes]

    def film(self, task: str, condition: str, seed: int, name: str) -> Path:
        """Return the film of an episode; `name` is the method's in the table, or says what else it shows."""
        return self.output / "videos" / task / condition / f"{seed}_{_file_name(name)}.mp4"

    def trace(self, task: str, condition: str, seed: int, name: str) -> Path:
        """Return what is kept of a filmed episode's interventions; see `TraceFile`."""
        return self.film(task, condition, seed, name).with_suffix(".npy")

    def _watchers(self, job: Job, seed: int) -> list[Watcher]:
        from lerobot_dexflex.evaluation.report.film import Film
        from lerobot_dexflex.evaluation.report.interventions import TraceFile
        from lerobot_dexflex.evaluation.report.rerun_log import RerunLog

        where = (job.task, job.condition, seed, job.method)
        seen: list[Watcher] = [Film(self.film(*where)), TraceFile(self.trace(*where))]
        if not self.rerun:
            return seen
        path = self.output / "rerun" / job.task / job.condition / f"{seed}_{_file_name(job.method)}.rrd"
        return [*seen, RerunLog(path, job.method, seed)]


def compare(comparison: Comparison, workers: int = 2, quiet: bool = False) -> pd.DataFrame:
    """Run what is missing and return the rows of this comparison.

    Rows of another version of a method (code, weights, settings) stay in the table and are not returned.

    Args:
        comparison: What to compare.
        workers: Worker processes; 0 runs in this process. The rows do not depend on it.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If a checkpoint does not fit, or another process works in the folder.
        KeyboardInterrupt: After the running batches were finished and stored.
    """
    for players in comparison.players.values():
        players.check(comparison.methods)
    versions = comparison.versions()
    jobs = comparison.jobs(versions)
    table, run = comparison.table, comparison.run_job
    return run_missing(table, COLUMNS, jobs, versions.values(), run, workers, quiet, status=_status)


def _check_condition(name: str) -> None:
    condition = Condition.parse(name)
    if name != condition.name:  # Under another name its rows would run again.
        raise DexFlexError(f"Write the condition {name!r} as {condition.name!r}.")
    if words := [word for word in condition.setting if word in IN_HAND]:
        raise DexFlexError(
            f"{name!r}: `{words[0]}` means something in the in-hand benchmark only "
            "(eval/degraded_commands.py)."
        )


def _status(rows: pd.DataFrame) -> str:
    last = rows.iloc[-1]
    return f"{last['method']} {last['task']} {last['condition']}: {rows['success'].sum()}/{len(rows)}"


def _file_name(method: str) -> str:
    return method.replace("/", "_").replace(":", "_")
