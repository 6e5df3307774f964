"""The scripted experts as operators: teleoperation through glove and interface, compared like policies."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.evaluation.command_errors import NO_ERRORS, CommandErrors, SupportRemoval
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.evaluation.policies import ObservedInterface, controller_digests
from lerobot_dexflex.evaluation.provenance import code_digest
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.recording.operation import OperatedHand, checked_interface, load_interface

_OPERATOR = 2
"""Tells the operator's own random numbers from those of the errors."""


@dataclass(frozen=True)
class Operators:
    """A task's scripted expert, whose commanded fingertips pass through a glove and an interface."""

    task: str
    controller: str = ""
    """Folder or hub id of the controller for interfaces that need one; empty is the shipped one."""
    errors: CommandErrors = NO_ERRORS
    """What glove and tracker make of the commanded fingertips."""

    def __call__(self, interface: str) -> "OperatorController":
        """Let the operator work through an interface."""
        return OperatorController(self, interface)

    def identity(self, interfaces: Sequence[str]) -> dict[str, str]:
        """Check the task and the interfaces; returns what decides the operator's behaviour.

        Raises:
            DexFlexError: If the task has no expert, an interface does not read drafts or lacks a controller.
        """
        make_expert(self.task)
        for name in interfaces:
            checked_interface(name)
        return {
            "operator": code_digest(("experts", "recording/operation.py"), policies=False),
            **controller_digests(interfaces, self.controller),
            **self.errors.identity(),
        }


class OperatorController:
    """A privileged expert per episode. Satisfies `Controller`, but must see the environments first.

    Args:
        operators: Task and errors of the commands.
        interface: What executes the commanded fingertips.
    """

    def __init__(self, operators: Operators, interface: str) -> None:
        self._operators, self._name = operators, interface
        self._observers: list[ObservedInterface] = []
        self._seeds: Sequence[int] = ()
        self._commands: list[Iterator[Command]] = []
        self._hands: list[OperatedHand] = []
        self._last: dict[int, Command] = {}

    @property
    def motion(self) -> Motion | None:
        """See `Controller.motion`."""
        rows = [observer.motion for observer in self._observers[: len(self._hands)]]
        if any(row is None for row in rows):
            return None
        return Motion(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))

    def reset(self, seeds: Sequence[int]) -> None:
        """Start one episode per seed."""
        self._seeds, self._commands, self._hands, self._last = seeds, [], [], {}
        while len(self._observers) < len(seeds):
            self._observers.append(ObservedInterface(load_interface(self._name, self._operators.controller)))

    def see(self, environments: Sequence[gymnasium.Env]) -> None:
        """Look at the episodes that have just been reset; called once per episode, before the first step."""
        expert, errors = make_expert(self._operators.task), self._operators.errors
        for row, (env, seed) in enumerate(zip(environments, self._seeds, strict=True)):
            self._commands.append(expert(env.unwrapped, np.random.default_rng((seed, _OPERATOR))))
            interface = self._observers[row]
            if errors.removal:
                interface = SupportRemoval(interface, errors.removal)
                interface.begin([seed])
            start = env.get_wrapper_attr("command")[7:]
            self._hands.append(OperatedHand(interface, errors.noise, np.random.default_rng(seed), start))

    def act(self, observation: Mapping[str, Any], task: str) -> NDArray[np.floating]:
        """Return joint targets [rad], shape (batch, 23); an expert that is done keeps its last command."""
        del task
        actions = []
        for row, (commands, hand) in enumerate(zip(self._commands, self._hands, strict=True)):
            command = self._last[row] = next(commands, None) or self._last[row]
            mine = {name: value[row] for name, value in observation.items() if name != "pixels"}
            actions.append(hand.move(mine, command).executed)
        return np.stack(actions)
