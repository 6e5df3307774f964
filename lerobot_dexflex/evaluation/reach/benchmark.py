"""Run methods under conditions on the same chains of goals; every episode leaves a row."""

import functools
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import torch

from lerobot_dexflex.commands.loop import MAX_STEPS
from lerobot_dexflex.envs.disturbance import DISTURBANCES
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.conditions import IN_HAND, Condition
from lerobot_dexflex.evaluation.reach.bounds import ORACLE
from lerobot_dexflex.evaluation.reach.chain_book import TEST_SEED, TUNING_SEED, ChainBook
from lerobot_dexflex.evaluation.reach.episodes import COLUMNS, chain_digest, run_episodes
from lerobot_dexflex.experts.reach.chains import Chain
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces.method import Method, require_drafts
from lerobot_dexflex.interfaces.protocol import Interface
from lerobot_dexflex.runs.jobs import Job, run_missing, wanted
from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.provenance import Version, method_version
from lerobot_dexflex.runs.table import Row, Table

TASK, TABLE = "Reach-v0", "reach.csv"
_RUN_BY = ("lerobot_dexflex.evaluation.reach.episodes", "lerobot_dexflex.commands.loop", TASKS[TASK].module)
"""Modules that run every episode; what they import decides it."""


@dataclass(frozen=True)
class Benchmark:
    """A paired comparison of methods under spoilt commands.

    Raises:
        DexFlexError: If a name means nothing, stands there twice or differs from its canonical spelling, or a
            number is below 1.
    """

    methods: tuple[str, ...]
    conditions: tuple[str, ...]
    output: Path
    """Folder of the results."""
    chains: Path
    """Folder of the chains, shared by all benchmarks."""
    episodes: int = 300
    """Episodes per method and condition."""
    oracle_episodes: int = 48
    """Episodes of oracles, the first ones: they take about a hundred times as long."""
    controller: str = ""
    """Folder or hub id of the trained controller; empty: the shipped one."""
    hand: str = "leap"
    """Name of the hand."""
    tuning: bool = False
    """Use the tuning objects, on which gains and settings may be chosen."""
    group: int = 100
    """Episodes that are run and stored together."""
    batch: int = 16
    """Hands that are simulated side by side within a group."""

    def __post_init__(self) -> None:
        get_hand(self.hand)
        for name in ("episodes", "oracle_episodes", "group", "batch"):
            if getattr(self, name) < 1:
                raise DexFlexError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        for name in ("methods", "conditions"):
            values = getattr(self, name)
            if not values or len(set(values)) < len(values):
                raise DexFlexError(f"`{name}` must be one or more different names. Got {', '.join(values)}.")
        for name in self.methods:
            _check_spelling(name, require_drafts(name).name)
        for name in self.conditions:
            _check_condition(name)

    @property
    def first_seed(self) -> int:
        """Seed of the first start."""
        return TUNING_SEED if self.tuning else TEST_SEED

    @property
    def table(self) -> Path:
        """The rows, one per episode."""
        return self.output / TABLE

    def book(self, condition: str) -> ChainBook:
        """Return the chains of a condition; all conditions of the same goals share theirs."""
        verified = Condition.parse(condition).verified
        return ChainBook(get_hand(self.hand), self.chains, self.first_seed, verified)

    def version(self, method: str) -> Version:
        """Return what decides the episodes of a method.

        Raises:
            DexFlexError: If it needs a controller that is not there.
        """
        parsed = Method.parse(method)
        hand = get_hand(self.hand)
        modules, weights = (*_RUN_BY, *parsed.modules), parsed.weights(hand, self.controller)
        settings = {"batch": self.batch, "group": self.group, "max_steps": MAX_STEPS, "hand": hand.signature}
        return method_version(modules, weights, **settings)

    def count(self, method: str) -> int:
        """Return the episodes of a method in each condition."""
        few = Method.parse(method).base == ORACLE
        return min(self.oracle_episodes, self.episodes) if few else self.episodes

    def jobs(self, versions: dict[str, Version]) -> list[Job]:
        """Return what is to run, all methods of a group side by side; the chains must have been built."""
        seeds = {name: list(_chains(self.book(name), self.episodes)) for name in self.conditions}
        return [
            Job(method, versions[method].name, TASK, condition, tuple(group))
            for first in range(0, self.episodes, self.group)
            for condition in self.conditions
            for method in self.methods
            if (group := seeds[condition][first : min(first + self.group, self.count(method))])
        ]

    def run_job(self, job: Job) -> list[Row]:
        """Run the episodes of a job."""
        chains = _chains(self.book(job.condition), self.episodes)
        interface = _interface(self.hand, job.method, self.controller)
        return run_episodes([chains[seed] for seed in job.seeds], job.condition, interface, self.batch)


def run(benchmark: Benchmark, workers: int = 2, quiet: bool = False) -> pd.DataFrame:
    """Run what is missing and return the rows of this benchmark.

    Rows of another version of a method (code, weights, settings) stay in the table and are not returned.

    Args:
        benchmark: What to run.
        workers: Worker processes; 0 runs in this process.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If a controller is missing, rows were run on other chains, or another process works in
            the folder.
        KeyboardInterrupt: After the running groups were finished and stored.
    """
    versions = {name: benchmark.version(name) for name in benchmark.methods}
    for condition in benchmark.conditions:
        benchmark.book(condition).ensure(benchmark.episodes, workers, quiet)
    jobs = benchmark.jobs(versions)
    with locked(benchmark.output):
        _refuse_other_chains(benchmark, wanted(Table(benchmark.table, COLUMNS).load(), jobs))
    return run_missing(
        benchmark.table, COLUMNS, jobs, versions.values(), benchmark.run_job, workers, quiet, status=_status
    )


def _check_spelling(name: str, canonical: str) -> None:
    if name != canonical:  # Under another name its rows would run again.
        raise DexFlexError(f"Write {name!r} as {canonical!r}.")


def _check_condition(name: str) -> None:
    _check_spelling(name, Condition.parse(name).name)
    if disturbed := sorted(set(name.split("+")) & set(DISTURBANCES)):
        raise DexFlexError(
            f"The in-hand benchmark spoils commands only; it has no {', '.join(disturbed)} hand. Valid in "
            f"conditions: errors of commands, {', '.join(IN_HAND)}."
        )


def _refuse_other_chains(benchmark: Benchmark, rows: pd.DataFrame) -> None:
    for condition, part in rows.groupby("condition"):
        chains = _chains(benchmark.book(str(condition)), benchmark.episodes)
        for seed, chain in zip(part["seed"], part["chain"], strict=True):
            if chain_digest(chains[seed]) != chain:
                raise DexFlexError(
                    f"The episode of seed {seed} in {benchmark.table} was run on another chain than the one "
                    f"in {benchmark.chains}. Restore the chains, or choose another --output."
                )


def _status(rows: pd.DataFrame) -> str:
    first = rows.iloc[0]
    return f"{first['method']} in {first['condition']}: progress {rows['progress'].mean():.2f}"


@functools.cache
def _chains(book: ChainBook, count: int) -> dict[int, Chain]:
    """Return the first `count` chains by their seeds, in order."""
    return {chain.seed: chain for chain in book.load(count)}


@functools.cache
def _interface(hand: str, method: str, controller: str) -> Interface:
    torch.set_num_threads(1)
    return Method.parse(method).make(get_hand(hand), controller)
