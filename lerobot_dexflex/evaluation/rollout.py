"""Run a batch of episodes in lock-step."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.outcome import Motion, Recorder


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


@runtime_checkable
class Privileged(Protocol):
    """A controller that looks into the simulator: operators, never policies."""

    def see(self, environments: Sequence[gymnasium.Env]) -> None:
        """Look at the environments of a batch after their reset."""
        ...


class Watcher(Protocol):
    """Sees every step of one episode, to film or log it."""

    def watch(
        self, env: gymnasium.Env, observation: Any, info: dict[str, Any], motion: Motion | None
    ) -> None:
        """See the state after the reset or after a step."""
        ...


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
    if isinstance(controller, Privileged):
        controller.see(environments[: len(seeds)])
    recorders = [
        Recorder(info, 1 / environments[k].metadata["render_fps"]) for k, (_, info) in enumerate(started)
    ]
    watchers = watchers or {}
    for k, (observation, info) in enumerate(started):
        for watcher in watchers.get(k, ()):
            watcher.watch(environments[k], observation, info, None)
    task = str(environments[0].get_wrapper_attr("task_description"))
    running = set(rows)
    while running:
        actions = controller.act(_stack(observations), task)
        motion = controller.motion
        for k in sorted(running):
            row = None if motion is None else motion.row(k)
            observations[k], _, terminated, truncated, info = environments[k].step(actions[k])
            recorders[k].add(info, row)
            for watcher in watchers.get(k, ()):
                watcher.watch(environments[k], observations[k], info, row)
            if terminated or truncated:
                running.discard(k)
    return recorders


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
