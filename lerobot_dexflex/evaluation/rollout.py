"""Run a batch of episodes in lock-step: who acts, in which environments, under which condition."""

import functools
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.conditions import Condition
from lerobot_dexflex.evaluation.outcome import Ended, Motion, Recorder
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.runs.provenance import Version


class Controller(Protocol):
    """A policy under one interface, batched over episodes."""

    @property
    def motion(self) -> Motion | None:
        """What the interface made of the draft in the last `act`; None where there is no draft."""
        ...

    def reset(self, seeds: Sequence[int]) -> None:
        """Start one episode per seed; the seed alone decides the episode's policy noise."""
        ...

    def act(self, observation: dict[str, Any], task: str) -> NDArray[np.floating]:
        """Return joint targets [rad], shape (batch, joints), for observations stacked over episodes."""
        ...


class Players(Hashable, Protocol):
    """Makes the controllers of methods, on one task, in worker processes; picklable."""

    @property
    def hand(self) -> Hand:
        """The hand that they move."""
        ...

    def __call__(self, method: str, errors: CommandErrors) -> Controller:
        """Load the controller of a method, whose commands go wrong by `errors`."""
        ...

    def version(self, method: str, task: str, **settings: Any) -> Version:
        """Return what decides the episodes of a method; `settings` are what else does."""
        ...

    def check(self, methods: Sequence[str]) -> None:
        """Refuse what cannot be run.

        Raises:
            DexFlexError: If a method, a checkpoint or a controller is missing or does not fit.
        """
        ...


@runtime_checkable
class Onlooker(Protocol):
    """A controller that looks into the simulator: operators, never policies."""

    def see(self, environments: Sequence[gymnasium.Env]) -> None:
        """Look at the environments of a batch after their reset."""
        ...


@runtime_checkable
class Glancing(Protocol):
    """A controller that looks in some steps only: rendering takes a third of a rollout's time."""

    @property
    def looks(self) -> bool:
        """Whether the next `act` reads images."""
        ...


class Watcher(Protocol):
    """Sees every step of one episode and its end, to film or log it."""

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """See the state after the reset or after a step."""
        ...

    def close(self, outcome: Ended) -> None:
        """Hear how it ended."""
        ...


def run_job(
    players: Players,
    method: str,
    env_id: str,
    condition: Condition,
    seeds: Sequence[int],
    watchers: Mapping[int, Sequence[Watcher]] | None = None,
    cameras: bool = True,
) -> list[Recorder]:
    """Run one episode per seed in this process's environments; arguments and errors as `run_group`.

    Args:
        players: Makes the controller of `method`.
        method: Who acts.
        env_id: Gymnasium id of the task.
        condition: What differs from the demonstrations.
        seeds: One per row.
        watchers: Watchers of some rows.
        cameras: Whether the controller sees; without, it is faster.
    """
    environments = [
        _environment(players.hand, env_id, condition.disturbance, cameras or bool(watchers), row)
        for row in range(len(seeds))
    ]
    return run_group(environments, _controller(players, method, condition.errors), seeds, watchers)


@functools.cache
def _environment(hand: Hand, env_id: str, disturbance: str, cameras: bool, row: int) -> gymnasium.Env:
    """Return this process's environment of a row; `reset` alone decides an episode, so it is re-used."""
    del row
    options: dict[str, Any] = {"hand": hand}
    if disturbance != "none":
        options["disturbance"] = disturbance
    if cameras:
        return gymnasium.make(env_id, render_mode="rgb_array", disable_env_checker=True, **options)
    return gymnasium.make(env_id, cameras=(), disable_env_checker=True, **options)


@functools.cache
def _controller(players: Players, method: str, errors: CommandErrors) -> Controller:
    torch.set_num_threads(1)
    return players(method, errors)


def run_group(
    environments: Sequence[gymnasium.Env],
    controller: Controller,
    seeds: Sequence[int],
    watchers: Mapping[int, Sequence[Watcher]] | None = None,
) -> list[Recorder]:
    """Run one episode per seed; ended episodes stand still until the last one ends.

    The batch keeps its size to the end, so an episode's numbers depend on its group only.

    Args:
        environments: At least one environment per seed, with a time limit.
        controller: Policy and interface.
        seeds: Seeds of initial states and of policy noise.
        watchers: Watchers of some rows.

    Returns:
        One recorder per seed.

    Raises:
        DexFlexError: If the environment does not report `is_success` and `progress`.
    """
    controller.reset(seeds)
    rows = range(len(seeds))
    started = [environments[k].reset(seed=seeds[k]) for k in rows]
    observations = [observation for observation, _ in started]
    _check_info(environments[0], started[0][1])
    if isinstance(controller, Onlooker):
        controller.see(environments[: len(seeds)])
    recorders = [_recorder(environments[k], info) for k, (_, info) in enumerate(started)]
    watchers = watchers or {}
    for k, (observation, info) in enumerate(started):
        for watcher in watchers.get(k, ()):
            watcher.watch(environments[k], observation, info, None)
    task = str(environments[0].get_wrapper_attr("task_description"))
    running = set(rows)
    while running:
        actions = controller.act(_stack(observations), task)
        motion = controller.motion
        looks = not isinstance(controller, Glancing) or controller.looks
        for k in sorted(running):
            environments[k].unwrapped.seeing = looks or k in watchers  # pyright: ignore[reportAttributeAccessIssue]
            row = None if motion is None else motion.row(k)
            observations[k], _, terminated, truncated, info = environments[k].step(actions[k])
            recorders[k].add(info, row)
            for watcher in watchers.get(k, ()):
                watcher.watch(environments[k], observations[k], info, row)
            if terminated or truncated:
                running.discard(k)
    return recorders


def _recorder(env: gymnasium.Env, info: dict[str, Any]) -> Recorder:
    assert env.spec is not None
    assert env.spec.max_episode_steps is not None
    return Recorder(info, 1 / env.metadata["render_fps"], env.spec.max_episode_steps)


def _check_info(env: gymnasium.Env, info: dict[str, Any]) -> None:
    missing = [key for key in ("is_success", "progress") if key not in info]
    if missing:
        raise DexFlexError(
            f"{env.spec.id if env.spec else env} must report `is_success` and `progress` in the info of "
            f"reset and every step. Missing: {missing}; got {sorted(info)}."
        )


def _stack(observations: Sequence[Any]) -> Any:
    """Stack observations (nested dicts of arrays) along a new first axis."""
    if isinstance(observations[0], dict):
        return {key: _stack([item[key] for item in observations]) for key in observations[0]}
    return np.stack(observations)
