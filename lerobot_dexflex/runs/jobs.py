"""Run the episodes that a table lacks, in worker processes, each job's rows stored as it finishes."""

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.provenance import Version
from lerobot_dexflex.runs.table import KEY, Row, Table
from lerobot_dexflex.runs.workers import run_each


@dataclass(frozen=True)
class Job:
    """Episodes of one method under one condition that run together."""

    method: str
    version: str
    task: str
    condition: str
    seeds: tuple[int, ...]
    """Seed of each episode; the same seed is the same episode under every method."""

    def rows(self) -> list[tuple[str, str, str, str, int]]:
        """Return what identifies the rows it leaves."""
        return [(self.method, self.version, self.task, self.condition, seed) for seed in self.seeds]


def run_missing(
    path: Path,
    columns: Sequence[str],
    jobs: Sequence[Job],
    versions: Iterable[Version],
    run_job: Callable[[Job], Sequence[Row]],
    workers: int = 2,
    quiet: bool = False,
    status: Callable[[pd.DataFrame], str] | None = None,
) -> pd.DataFrame:
    """Run the jobs whose rows the table lacks; return the rows of all jobs.

    Rows of other methods, versions and conditions stay in the table and are not returned.

    Args:
        path: The table.
        columns: Columns that `run_job` fills.
        jobs: What is wanted.
        versions: Of every job, for `runs.csv`.
        run_job: Given a job, one row per seed, in order; runs in a worker (picklable). The key columns are
            filled in here.
        workers: Worker processes; 0 works in this one. The rows do not depend on it.
        quiet: Show no progress bar.
        status: Given the rows so far, a short text for the bar.

    Raises:
        DexFlexError: If another process works in the folder, or the file is no table.
        KeyboardInterrupt: After the running jobs were finished and stored.
    """
    with locked(path.parent):
        table = Table(path, columns)
        found = wanted(table.load(), jobs)
        done = set(found[list(KEY)].itertuples(index=False, name=None))
        missing = [job for job in jobs if not done.issuperset(job.rows())]
        known = {version.name: version for version in versions}
        for method, name in dict.fromkeys((job.method, job.version) for job in missing):
            table.remember(method, known[name])
        waiting = iter(missing)
        total = sum(len(job.seeds) for job in jobs)
        left = sum(len(job.seeds) for job in missing)
        with tqdm(total=total, initial=total - left, unit="episode", disable=quiet) as bar:
            work = functools.partial(_work, table, run_job)
            for rows in run_each(work, lambda running: next(waiting, None), workers):
                bar.update(len(rows))
                if status:
                    bar.set_postfix_str(status(pd.DataFrame(rows)))
        return wanted(table.load(), jobs)


def wanted(rows: pd.DataFrame, jobs: Sequence[Job]) -> pd.DataFrame:
    """Return the rows of the jobs, in the jobs' order; those that have not run are missing."""
    keys = pd.DataFrame([key for job in jobs for key in job.rows()], columns=pd.Index(KEY))
    return keys.merge(rows, on=list(KEY), how="inner")


def _work(table: Table, run_job: Callable[[Job], Sequence[Row]], job: Job) -> list[Row]:
    rows = [dict(zip(KEY, key, strict=True)) | row for key, row in zip(job.rows(), run_job(job), strict=True)]
    table.append(rows)
    return rows
