"""The scripted experts as operators: teleoperation through glove and interface, compared like policies."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.evaluation.policies import ObservedInterface, controller_digests
from lerobot_dexflex.evaluation.provenance import code_digest
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.recording.operation import OperatedHand, checked_interface, load_interface

_OPERATOR = 1
"""Tells the operator's own random numbers from those of its glove."""


@dataclass(frozen=True)
class Operators:
    """A task's scripted expert, whose commanded fingertips pass through a glove and an interface."""

    task: str
    glove_noise: float = 0.0
    """Half width of uniform noise on every commanded fingertip coordinate and step [m]."""
    controller: str = ""
    """Folder or hub id of the controller for interfaces that need one; empty is the shipped one."""

    def __call__(self, interface: str) -> "OperatorController":
        """Let the operator work through an interface."""
        return OperatorController(self, interface)

    def identity(self, interfaces: Sequence[str]) -> dict[str, str]:
        """Check the task, the noise and the interfaces; returns what decides the operator's behaviour.

        Raises:
            DexFlexError: If the task has no expert, an interface does not read drafts or lacks a controller.
        """
        make_expert(self.task)
        for name in interfaces:
            checked_interface(name)
        if not self.glove_noise >= 0:
            raise DexFlexError(f"`glove_noise` must be 0 or more [m]. Got {self.glove_noise}.")
        return {
            "operator": code_digest(("experts", "recording/operation.py"), policies=False),
            "glove_noise": str(self.glove_noise),
            **controller_digests(interfaces, self.controller),
        }


class OperatorController:
    """A privileged expert per episode. Satisfies `Controller`, but must see the environments first.

    Args:
        operators: Task and glove.
        interface: What executes the commanded fingertips.
    """

    def __init__(self, operators: Operators, interface: str) -> None:
        self._operators, self._name = operators, interface
        self._interfaces: list[ObservedInterface] = []
        self._seeds: Sequence[int] = ()
        self._commands: list[Iterator[Command]] = []
        self._hands: list[OperatedHand] = []
        self._last: list[Command] = []

    @property
    def motion(self) -> Motion | None:
        """See `Controller.motion`."""
        rows = [interface.motion for interface in self._interfaces[: len(self._hands)]]
        if any(row is None for row in rows):
            return None
        return Motion(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))

    def reset(self, seeds: Sequence[int]) -> None:
        """Start one episode per seed."""
        self._seeds, self._commands, self._hands, self._last = seeds, [], [], []
        while len(self._interfaces) < len(seeds):
            self._interfaces.append(ObservedInterface(load_interface(self._name, self._operators.controller)))

    def see(self, environments: Sequence[gymnasium.Env]) -> None:
        """Look at the episodes that have just been reset; called once per episode, before the first step."""
        expert = make_expert(self._operators.task)
        for row, (env, seed) in enumerate(zip(environments, self._seeds, strict=True)):
            self._commands.append(expert(env.unwrapped, np.random.default_rng((seed, _OPERATOR))))
            start = env.get_wrapper_attr("command")[7:]
            rng = np.random.default_rng(seed)
            noise = self._operators.glove_noise
            self._hands.append(OperatedHand(self._interfaces[row], noise, rng, start))

    def act(self, observation: Mapping[str, Any], task: str) -> NDArray[np.floating]:
        """Return joint targets [rad], shape (batch, 23); an expert that is done keeps its last command."""
        del task
        actions = []
        for row, (commands, hand) in enumerate(zip(self._commands, self._hands, strict=True)):
            command = next(commands, None) or self._last[row]
            self._last[row : row + 1] = [command]
            mine = {name: value[row] for name, value in observation.items() if name != "pixels"}
            actions.append(hand.move(mine, command).executed)
        return np.stack(actions)
