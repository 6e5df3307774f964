"""Chains on disk: built once, by the same command that needs them; used by every method."""

import functools
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from tqdm import tqdm

from lerobot_dexflex.commands.families import NO_ERRORS
from lerobot_dexflex.commands.loop import run_chains
from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.reach.privileged import OperatorInterface
from lerobot_dexflex.experts.reach.chains import MAX_STEPS, Chain, build_chain
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.runs.lock import locked
from lerobot_dexflex.runs.workers import run_each

TUNING_SEED, TEST_SEED = 50_000, 100_000
Build = Callable[[Hand, int, bool], Chain | None]


@dataclass(frozen=True)
class ChainBook:
    """One file of chains; line by line a seed and its chain, or null where the operator failed.

    Episode k is the chain of the k-th seed, counted from `first_seed`, that has one.

    Args:
        hand: The hand that holds the objects.
        folder: Of the file, JSON lines; created when something is built.
        first_seed: The first seed.
        verified: Whether goals are verified by the operator.
    """

    hand: Hand
    folder: Path
    first_seed: int
    verified: bool = False

    @property
    def path(self) -> Path:
        """The file, named after all that decides its chains."""
        kind = "verified" if self.verified else "unverified"
        return self.folder / f"{self.hand.signature}_{kind}_{self.first_seed}.jsonl"

    def ensure(self, count: int, workers: int = 2, quiet: bool = False, build: Build | None = None) -> None:
        """Build chains until there are `count`; what is there is kept, so an interrupt loses little.

        Args:
            count: How many are needed.
            workers: Worker processes; 0 builds in this process.
            quiet: Show no progress bar.
            build: Builds the chain of a hand and seed, or finds none; `build_in_simulator` if None.

        Raises:
            DexFlexError: If chains are missing and another process builds some in the same folder.
        """
        if self._found(self._read()) < count:
            with locked(self.folder):
                self._build(count, workers, quiet, build or build_in_simulator)

    def _build(self, count: int, workers: int, quiet: bool, build: Build) -> None:
        known = self._read()
        _end_last_line(self.path)
        job = functools.partial(_build_line, self.path, functools.partial(build, self.hand), self.verified)
        waiting = self.first_seed
        started: set[int] = set()

        def next_seed(running: int) -> int | None:
            nonlocal waiting
            if self._found(known) + running >= count:
                return None  # Those that are running may be enough.
            while waiting in known or waiting in started:
                waiting += 1
            started.add(waiting)
            return waiting

        with tqdm(total=count, initial=self._found(known), desc=self.path.stem, disable=quiet) as bar:
            for seed, chain in run_each(job, next_seed, workers):
                known[seed] = chain
                bar.update(chain is not None)

    def load(self, count: int) -> list[Chain]:
        """Return the first `count` chains.

        Raises:
            DexFlexError: If there are fewer.
        """
        chains = [chain for chain in self._in_order(self._read()) if chain is not None][:count]
        if len(chains) < count:
            raise DexFlexError(
                f"{self.path} holds {len(chains)} chains in a row, {count} are needed; build them."
            )
        return chains

    def _found(self, known: dict[int, Chain | None]) -> int:
        return sum(chain is not None for chain in self._in_order(known))

    def _in_order(self, known: dict[int, Chain | None]) -> list[Chain | None]:
        """Return the chains of the seeds known without a gap: their order does not depend on who was fast."""
        found = []
        seed = self.first_seed
        while seed in known:
            found.append(known[seed])
            seed += 1
        return found

    def _read(self) -> dict[int, Chain | None]:
        known: dict[int, Chain | None] = {}
        for line in self.path.read_text().splitlines() if self.path.exists() else ():
            try:
                row = json.loads(line)
            except ValueError:  # Torn by a kill; built again.
                continue
            try:
                known[int(row["seed"])] = None if row["chain"] is None else Chain.from_json(row["chain"])
            except (KeyError, TypeError, ValueError, IndexError) as error:
                raise DexFlexError(
                    f"{self.path} holds a line that is no chain ({type(error).__name__}: {line[:60]!r}). "
                    "Remove that line; its chain is built again."
                ) from error
        return known


def build_in_simulator(hand: Hand, seed: int, verified: bool) -> Chain | None:
    """Return the chain of a seed with the operator's own steps, or None if there are no eight goals."""
    chain = build_chain(_environment(hand), seed, verified)
    return None if chain is None else replace(chain, steps=operator_steps(hand, chain))


def operator_steps(hand: Hand, chain: Chain) -> int:
    """Return how many control steps the operator takes with its own joint targets, by the loop's rules.

    `MAX_STEPS` if it drops the object.
    """
    (episode,) = run_chains([chain], NO_ERRORS, OperatorInterface(hand))
    return MAX_STEPS if episode.dropped else episode.steps


@functools.cache
def _environment(hand: Hand) -> ReachEnv:
    return ReachEnv(cameras=(), hand=hand)


def _end_last_line(path: Path) -> None:
    """Let what a kill tore off stand in a line of its own, that the next one is not lost with it."""
    if path.exists() and not path.read_bytes().endswith(b"\n"):
        with path.open("ab") as file:
            file.write(b"\n")


def _build_line(
    path: Path, build: Callable[[int, bool], Chain | None], verified: bool, seed: int
) -> tuple[int, Chain | None]:
    chain = build(seed, verified)
    line = json.dumps({"seed": seed, "chain": None if chain is None else chain.to_json()}) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(descriptor, line.encode())
    finally:
        os.close(descriptor)
    return seed, chain
