"""Run methods in cells, in worker processes, resumable."""

import functools
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from lerobot_dexflex.commands.loop import MAX_STEPS, run_chains
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.provenance import code_digest, environment_identity, session
from lerobot_dexflex.evaluation.reach.bounds import ORACLE, teacher_of
from lerobot_dexflex.evaluation.reach.cells import Cell
from lerobot_dexflex.evaluation.reach.chain_book import TEST_SEED, TUNING_SEED, ChainBook, chain_digest
from lerobot_dexflex.evaluation.reach.record import Record, make_record
from lerobot_dexflex.evaluation.store import Store
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.provenance import method_version
from lerobot_dexflex.runs.workers import run_each

_WORLD = (
    "hand",
    "envs",
    "experts/reach",
    "commands",
    *(f"evaluation/reach/{n}.py" for n in ("metrics", "record")),
)
"""Parts of the library on which all episodes depend."""
TRACED = 4
"""The series of the first so many episodes are kept."""

Job = tuple[str, str, tuple[int, int]]
"""Method, cell and first and one past the last episode."""


@dataclass(frozen=True)
class Benchmark:
    """A paired comparison of methods under degraded commands."""

    methods: tuple[str, ...]
    cells: tuple[str, ...]
    output: Path
    """Folder of the results."""
    chains: Path
    """Folder of the chains, shared by all benchmarks."""
    episodes: int = 300
    """Episodes per method and cell."""
    oracle_episodes: int = 48
    """Episodes of oracles, the first ones: they take about a hundred times as long."""
    controller: Path | None = None
    """Folder of the trained controller; the shipped one if None."""
    tuning: bool = False
    """Use the tuning objects, on which gains and settings may be chosen."""
    group: int = 100
    """Episodes that are run and stored together."""
    batch: int = 16
    """Hands that are simulated side by side within a group."""

    def __post_init__(self) -> None:
        for name in ("episodes", "oracle_episodes", "group", "batch"):
            if getattr(self, name) < 1:
                raise DexFlexError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        for name in ("methods", "cells"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise DexFlexError(f"`{name}` must be one or more different names. Got {', '.join(values)}.")
        for method in self.methods:
            Method.parse(method)
        for cell in self.cells:
            if Cell.parse(cell).name != cell:
                raise DexFlexError(f"Write {cell!r} as {Cell.parse(cell).name!r}.")

    @property
    def first_seed(self) -> int:
        """Seed of the first start."""
        return TUNING_SEED if self.tuning else TEST_SEED

    def book(self, verified: bool) -> ChainBook:
        """Return the chains of a kind of cell."""
        kind = "verified" if verified else "unverified"
        return ChainBook(self.chains / f"{kind}_{self.first_seed}.jsonl", self.first_seed, verified)

    def books(self) -> list[ChainBook]:
        """Return the chains that the cells need."""
        return [self.book(v) for v in (True, False) if any(Cell.parse(c).verified == v for c in self.cells)]

    def identity(self) -> dict[str, Any]:
        """Return the settings on which every episode depends; methods, cells, episodes are free to grow."""
        found = {"seed": self.first_seed, "group": self.group, "batch": self.batch, "max_steps": MAX_STEPS}
        return found | environment_identity() | {"code": code_digest(_WORLD, policies=False)}

    def count(self, method: str) -> int:
        """Return the episodes of a method in each cell."""
        few = Method.parse(method).base == ORACLE
        return min(self.oracle_episodes, self.episodes) if few else self.episodes

    def jobs(self) -> list[Job]:
        """Return what is to run, all methods of a group side by side."""
        starts = range(0, self.episodes, self.group)
        return [
            (method, cell, (first, min(first + self.group, self.count(method))))
            for first in starts
            for cell in self.cells
            for method in self.methods
            if first < self.count(method)
        ]

    def run_job(self, store: Store[Record], number: int) -> list[Record]:
        """Run and store a group."""
        name, cell_name, (first, end) = self.jobs()[number]
        cell, method = Cell.parse(cell_name), Method.parse(name)
        chains = _chains(self.book(cell.verified), self.count(name))[first:end]
        episodes = run_chains(
            [chain for chain, _ in chains],
            cell.corruption,
            _interface(name, self.controller),
            batch=self.batch,
            teacher=teacher_of(method),
        )
        records = [
            make_record(
                episode,
                method=name,
                cell=cell_name,
                index=first + k,
                chain=chains[k][1],
                version=_version(name, self.controller),
                group=(first, end),
                traced=first + k < TRACED,
            )
            for k, episode in enumerate(episodes)
        ]
        store.append(records)
        return records


def run(benchmark: Benchmark, workers: int = 2, quiet: bool = False) -> tuple[Store[Record], list[Record]]:
    """Run what is missing and return the store and all records of this benchmark's jobs.

    Records of another version of a method (its code or weights) are run again, those of all others stay.

    Args:
        benchmark: What to run.
        workers: Worker processes; 0 runs in this process. The episodes do not depend on it.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If the output folder holds other settings or chains, or a controller is missing.
        KeyboardInterrupt: After the running groups were finished and stored.
    """
    for name in benchmark.methods:
        _version(name, benchmark.controller)  # Refuses a missing controller before anything runs.
    store = Store(benchmark.output, benchmark.identity(), Record.parse)
    for book in benchmark.books():
        book.ensure(benchmark.episodes, workers, quiet)
    finished = _finished(benchmark, store)
    started, new = time.time(), 0
    try:
        for records in _run(benchmark, store, finished, workers, quiet):
            new += len(records)
            finished += records
    finally:
        if new:
            store.add_session(session(started, new, workers))
    return store, finished


def _finished(benchmark: Benchmark, store: Store[Record]) -> list[Record]:
    wanted = set(benchmark.jobs())
    versions = {name: _version(name, benchmark.controller) for name in benchmark.methods}
    finished = [r for r in store.load() if r.job in wanted and r.version == versions[r.method]]
    digests = {
        book.verified: [digest for _, digest in _chains(book, benchmark.episodes)]
        for book in benchmark.books()
    }
    for record in finished:
        if digests[Cell.parse(record.cell).verified][record.episode] != record.chain:
            raise DexFlexError(
                f"Episode {record.episode} in {store.root} was run on another chain than the one in "
                f"{benchmark.chains}. Restore the chains, or choose another --output."
            )
    return finished


def _run(
    benchmark: Benchmark, store: Store[Record], finished: Sequence[Record], workers: int, quiet: bool
) -> Iterable[list[Record]]:
    jobs = benchmark.jobs()
    done = {record.job for record in finished}
    numbers = iter([k for k, job in enumerate(jobs) if job not in done])
    with tqdm(
        total=sum(end - first for *_, (first, end) in jobs),
        initial=len(finished),
        unit="episode",
        disable=quiet,
    ) as bar:
        job = functools.partial(benchmark.run_job, store)
        for records in run_each(job, lambda running: next(numbers, None), workers):
            mean = sum(r.metrics["progress"] or 0.0 for r in records) / len(records)
            bar.set_postfix_str(f"{records[0].method} in {records[0].cell}: progress {mean:.2f}")
            bar.update(len(records))
            yield records


@functools.cache
def _chains(book: ChainBook, count: int) -> list[tuple[Any, str]]:
    return [(chain, chain_digest(chain)) for chain in book.load(count)]


@functools.cache
def _interface(method: str, controller: Path | None) -> Any:
    torch.set_num_threads(1)
    return Method.parse(method).make(controller)


@functools.cache
def _version(method: str, controller: Path | None) -> str:
    found = Method.parse(method)
    return method_version(found.modules, found.weights(controller)).name
