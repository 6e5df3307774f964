"""Jobs that each leave one result: run the missing ones in workers, store each as it finishes."""

import json
import time
from collections.abc import Callable, Hashable, Sequence
from typing import Self

from tqdm import tqdm

from lerobot_dexflex.evaluation.provenance import session
from lerobot_dexflex.evaluation.store import Storable, Store
from lerobot_dexflex.runs.workers import run_each


class WholeJob:
    """Base of dataclasses that are the one result of their job; satisfies `Storable` with a `job`."""

    @property
    def group(self) -> tuple[int, int]:
        """A job is one result."""
        return (0, 1)

    @property
    def episode(self) -> int:
        """Its index in the group."""
        return 0

    def line(self) -> str:
        """Return the result as one line of JSON."""
        return json.dumps(vars(self)) + "\n"

    @classmethod
    def parse(cls, line: str) -> Self:
        """Inverse of `line`.

        Raises:
            ValueError: If the line is torn or of another form.
        """
        try:
            return cls(**json.loads(line))
        except TypeError as error:
            raise ValueError(f"No {cls.__name__}: {line[:80]!r}") from error


def run_missing[Result: Storable](
    store: Store[Result],
    jobs: Sequence[Hashable],
    run_job: Callable[[int], Result],
    episodes_per_job: int,
    workers: int,
    quiet: bool = False,
) -> list[Result]:
    """Run the jobs whose results the store lacks; return the results of all, in order.

    Args:
        store: Where results are kept.
        jobs: The `job` of every result that is wanted.
        run_job: Given the number of a job in `jobs`, its result; called in the workers.
        episodes_per_job: For the record of the session.
        workers: Worker processes; 0 works in this one.
        quiet: Show no progress bar.

    Raises:
        KeyboardInterrupt: After the running jobs were finished and stored.
    """
    wanted = set(jobs)
    done = {found.job: found for found in store.load() if found.job in wanted}
    waiting = iter([n for n, job in enumerate(jobs) if job not in done])
    started, before = time.time(), len(done)
    try:
        with tqdm(total=len(jobs), initial=before, unit="job", disable=quiet) as bar:
            for found in run_each(run_job, lambda _: next(waiting, None), workers):
                store.append([found])
                done[found.job] = found
                bar.update()
    finally:
        if len(done) > before:
            store.add_session(session(started, episodes_per_job * (len(done) - before), workers))
    return [done[job] for job in jobs]
