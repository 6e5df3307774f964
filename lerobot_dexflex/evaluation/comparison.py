"""Run every interface on the same episodes, in worker processes, resumable."""

import functools
import time
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import gymnasium
import torch
from tqdm import tqdm

from lerobot_dexflex.envs.disturbance import find_disturbance
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.outcome import Outcome
from lerobot_dexflex.evaluation.provenance import (
    environment_identity,
    identity_digest,
    session,
    session_provenance,
)
from lerobot_dexflex.evaluation.report.film import Film
from lerobot_dexflex.evaluation.report.rerun_log import RerunLog
from lerobot_dexflex.evaluation.rollout import Controller, run_group
from lerobot_dexflex.evaluation.store import Store, write_json
from lerobot_dexflex.runs.workers import run_each

RESULT = "comparison.json"


class Policies(Hashable, Protocol):
    """Makes controllers in worker processes; picklable."""

    def __call__(self, interface: str) -> Controller:
        """Load the controller of an interface."""
        ...

    def identity(self, interfaces: Sequence[str]) -> dict[str, str]:
        """Return what decides the controllers' behaviour, flat: content hashes, device.

        Raises:
            DexFlexError: If an interface cannot be run with these checkpoints.
        """
        ...


@dataclass(frozen=True)
class Comparison:
    """A paired comparison of interfaces on one task."""

    env_id: str
    """Gymnasium id of the task."""
    interfaces: tuple[str, ...]
    policies: Policies
    output: Path
    """Folder of the results."""
    episodes: int = 100
    """Episodes per interface."""
    seed: int = 100_000
    """Episode i starts from environment seed `seed + i`, which also seeds the policy's noise."""
    batch_size: int = 1
    """Episodes that run in lock-step; part of the settings, because batched sums round differently."""
    videos: int = 4
    """The first so many episodes are filmed."""
    disturbance: str = "none"
    """What differs from the demonstrations: a name of `envs.disturbance.DISTURBANCES`."""
    rerun: bool = False
    """Also log the filmed episodes as rerun recordings."""

    def __post_init__(self) -> None:
        for name in ("episodes", "batch_size"):
            if getattr(self, name) < 1:
                raise DexFlexError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        for name in ("seed", "videos"):
            if getattr(self, name) < 0:
                raise DexFlexError(f"`{name}` must not be negative. Got {getattr(self, name)}.")
        find_disturbance(self.disturbance)
        if not self.interfaces or len(set(self.interfaces)) < len(self.interfaces):
            raise DexFlexError(f"`interfaces` must be one or more different names. Got {self.interfaces}.")

    def identity(self) -> dict[str, Any]:
        """Return the settings on which every episode depends; the number of episodes is free to grow."""
        names = {"env": self.env_id, "interfaces": " ".join(self.interfaces)}
        if self.disturbance != "none":
            names["disturbance"] = self.disturbance
        numbers = {"seed": self.seed, "batch_size": self.batch_size}
        return names | numbers | self.policies.identity(self.interfaces) | environment_identity()

    def group(self, index: int) -> tuple[int, int]:
        """Return the first and one past the last episode of a group."""
        return index * self.batch_size, min((index + 1) * self.batch_size, self.episodes)

    def jobs(self) -> list[tuple[str, tuple[int, int]]]:
        """Return what is to run, the interfaces side by side."""
        groups = [self.group(k) for k in range(-(-self.episodes // self.batch_size))]
        return [(name, group) for group in groups for name in self.interfaces]

    def run_job(self, store: Store[Outcome], number: int) -> list[Outcome]:
        """Run and store the group of one interface."""
        interface, (first, end) = self.jobs()[number]
        environments = [_environment(self.env_id, self.disturbance, row) for row in range(end - first)]
        watchers = {k - first: self._watchers(interface, k) for k in range(first, min(end, self.videos))}
        seeds = [self.seed + k for k in range(first, end)]
        recorders = run_group(environments, _controller(self.policies, interface), seeds, watchers)
        outcomes = [
            recorder.outcome(interface, first + row, seeds[row], (first, end))
            for row, recorder in enumerate(recorders)
        ]
        for row, row_watchers in watchers.items():
            for watcher in row_watchers:
                watcher.close(outcomes[row])
        store.append(outcomes)
        return outcomes

    def _watchers(self, interface: str, episode: int) -> list[Film | RerunLog]:
        film = Film(self.output / "videos" / f"{episode:04d}_{interface}.mp4")
        if not self.rerun:
            return [film]
        return [film, RerunLog(self.output / "rerun" / f"{episode:04d}_{interface}.rrd", interface, episode)]


@functools.cache
def _environment(env_id: str, disturbance: str, row: int) -> gymnasium.Env:
    """Return this process's environment of a row; `reset` alone decides an episode, so it is re-used."""
    del row
    options: dict[str, Any] = {} if disturbance == "none" else {"disturbance": disturbance}
    return gymnasium.make(env_id, render_mode="rgb_array", disable_env_checker=True, **options)


@functools.cache
def _controller(policies: Policies, interface: str) -> Controller:
    torch.set_num_threads(1)
    return policies(interface)


def compare(
    comparison: Comparison, workers: int = 2, quiet: bool = False
) -> tuple[dict[str, Any], list[Outcome]]:
    """Run what is missing; returns the content of the result file, which is also written, and its episodes.

    Args:
        comparison: What to compare.
        workers: Worker processes; 0 runs in this process. The episodes do not depend on it.
        quiet: Show no progress bar.

    Raises:
        DexFlexError: If the output folder holds other settings or a checkpoint does not fit.
        KeyboardInterrupt: After the running groups were finished and stored.
    """
    from lerobot_dexflex.evaluation.summary import summarise  # Seconds of imports that workers need not pay.

    identity = comparison.identity()
    store = Store(comparison.output, identity, Outcome.parse)
    jobs = comparison.jobs()
    finished = [o for o in store.load() if (o.interface, o.group) in set(jobs)]
    started = time.time()
    new = 0
    try:
        for outcomes in _run(comparison, store, finished, workers, quiet):
            new += len(outcomes)
            finished += outcomes
    finally:
        if new:
            store.add_session(session(started, new, workers))
    finished.sort(key=lambda o: (o.episode, comparison.interfaces.index(o.interface)))
    result = {
        "config_hash": identity_digest(identity),
        "identity": identity,
        "n_episodes": comparison.episodes,
        "seeds": [comparison.seed, comparison.seed + comparison.episodes - 1],
        **summarise(finished, comparison.interfaces, _stages(comparison.env_id)),
        "episodes": [_plain(o) for o in finished],
        "provenance": session_provenance(store.sessions()),
    }
    write_json(comparison.output / RESULT, result)
    return result, finished


def _run(
    comparison: Comparison, store: Store[Outcome], finished: Sequence[Outcome], workers: int, quiet: bool
) -> Iterable[list[Outcome]]:
    jobs = comparison.jobs()
    done = {(o.interface, o.group) for o in finished}
    numbers = iter([k for k, job in enumerate(jobs) if job not in done])
    rates = {name: [o.success for o in finished if o.interface == name] for name in comparison.interfaces}
    total = comparison.episodes * len(comparison.interfaces)
    with tqdm(total=total, initial=len(finished), unit="episode", disable=quiet) as bar:
        job = functools.partial(comparison.run_job, store)
        for outcomes in run_each(job, lambda running: next(numbers, None), workers):
            for outcome in outcomes:
                rates[outcome.interface].append(outcome.success)
            bar.set_postfix_str(", ".join(f"{name} {sum(r)}/{len(r)}" for name, r in rates.items()))
            bar.update(len(outcomes))
            yield outcomes


def _stages(env_id: str) -> tuple[str, ...]:
    task = TASKS.get(env_id.partition("/")[2])
    return task.stages if task else ()


def _plain(outcome: Outcome) -> dict[str, Any]:
    fields = outcome.__dict__.copy()
    fields["progress"] = [list(point) for point in outcome.progress]
    fields["group"] = list(outcome.group)
    return fields
