"""The tasks' operators as teleoperators: players whose commands pass through a glove."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.glove import GlovedHand
from lerobot_dexflex.commands.source import Source
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.evaluation import rollout
from lerobot_dexflex.evaluation.observed import ObservedInterface
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.experts import expert_module, make_expert
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.method import Method, make_interface
from lerobot_dexflex.runs.provenance import Version, method_version

_OWN = 2
"""Tells the teleoperator's own random numbers from those of the errors."""


@dataclass(frozen=True)
class Teleoperators:
    """A task's privileged operator, whose commands pass through a glove and an interface; see `GlovedHand`.

    `joint` executes the expert's own joints, bit for bit if nothing goes wrong; others read its drafts.
    """

    hand: Hand
    """The hand that is led."""
    task: str
    controller: str = ""
    """Folder or hub id of the controller for interfaces that need one; empty is the shipped one."""
    source: Source = "motion"
    """What drafts say."""

    def __call__(self, method: str, errors: CommandErrors = NO_ERRORS) -> "TeleoperatorController":
        """Let the teleoperator work through a method, with the errors of its glove and the person in it."""
        return TeleoperatorController(self, method, errors)

    def check(self, methods: Sequence[str]) -> None:
        """Refuse what cannot run, before anything does.

        Raises:
            DexFlexError: If the task has no expert, or a method is none or lacks a controller.
        """
        make_expert(self.task)
        for name in methods:
            Method.parse(name).weights(self.hand, self.controller)

    def version(self, method: str, task: str, **settings: Any) -> Version:
        """Return what decides a method's episodes; see `LeRobotPolicies.version`."""
        parsed = Method.parse(method)
        own = (rollout.__name__, type(self).__module__, TASKS[task].module, expert_module(self.task))
        weights = parsed.weights(self.hand, self.controller)
        source = {} if parsed.command_space == "joint" else {"source": self.source}
        settings |= {"method": parsed.name, "hand": self.hand.signature, **source}
        return method_version((*own, *parsed.modules), weights, **settings)


class TeleoperatorController:
    """A privileged expert per episode. Satisfies `Controller`, but must see the environments first.

    Args:
        teleoperators: Task and controller.
        method: What executes the commands.
        errors: Of the glove and the person in it.
    """

    def __init__(self, teleoperators: Teleoperators, method: str, errors: CommandErrors) -> None:
        self._teleoperators, self._method, self._errors = teleoperators, method, errors
        self._observers: list[ObservedInterface] = []
        self._seeds: Sequence[int] = ()
        self._commands: list[Iterator[Command]] = []
        self._hands: list[GlovedHand] = []
        self._last: dict[int, Command] = {}

    @property
    def motion(self) -> Motion | None:
        """See `Controller.motion`."""
        rows = [observer.change for observer in self._observers[: len(self._hands)]]
        if any(row is None for row in rows):
            return None
        return Motion(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))

    def reset(self, seeds: Sequence[int]) -> None:
        """Start one episode per seed."""
        self._seeds, self._commands, self._hands, self._last = seeds, [], [], {}
        while len(self._observers) < len(seeds):
            players = self._teleoperators
            interface = make_interface(players.hand, self._method, players.controller)
            self._observers.append(ObservedInterface(interface))

    def see(self, environments: Sequence[gymnasium.Env]) -> None:
        """Look at the episodes that have just been reset; called once per episode, before the first step."""
        players = self._teleoperators
        expert, source = make_expert(players.task), players.source
        for row, (env, seed) in enumerate(zip(environments, self._seeds, strict=True)):
            self._commands.append(expert(env.unwrapped, np.random.default_rng((seed, _OWN))))
            self._hands.append(GlovedHand(self._observers[row], self._errors, seed, source))

    def act(self, observation: Mapping[str, Any], task: str) -> NDArray[np.floating]:
        """Return joint targets [rad] (batch, joints); an expert that is done keeps its last command."""
        del task
        actions = []
        for row, (commands, hand) in enumerate(zip(self._commands, self._hands, strict=True)):
            command = self._last[row] = next(commands, None) or self._last[row]
            mine = {name: value[row] for name, value in observation.items() if name != "pixels"}
            actions.append(hand.move(mine, command).executed)
        return np.stack(actions)
