"""LeRobot checkpoints as players: who plays the episodes of a comparison."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.commands.disturbed import DisturbedInterface
from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation import rollout
from lerobot_dexflex.evaluation.checkpoints import (
    LoadedPolicy,
    adapter_modules,
    check_backbone,
    check_checkpoint,
    load_adapter,
    load_checkpoint,
    policy_modules,
)
from lerobot_dexflex.evaluation.observed import ObservedInterface
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.hands import Hand
from lerobot_dexflex.interfaces.method import Method
from lerobot_dexflex.runs.provenance import Version, method_version


@dataclass(frozen=True)
class LeRobotPolicies:
    """One checkpoint for all methods, which execute their parts of its plans, unless they have their own."""

    hand: Hand
    """The hand that the checkpoints were trained for."""
    policy: Path
    """Folder `pretrained_model`."""
    draft: str = ""
    """Which fingertips interfaces that read drafts execute: `measured` or `commanded`; empty leaves it to the
    checkpoint."""
    device: str = "cpu"
    controller: str = ""
    """Folder or hub id of the controller for interfaces that need one; empty is the shipped one."""
    own: tuple[tuple[str, Path], ...] = ()
    """Methods with a checkpoint of their own, e.g. trained on demonstrations recorded through them."""

    def __call__(self, method: str, errors: CommandErrors = NO_ERRORS) -> "LeRobotController":
        """Put the method's interface under its checkpoint, with what goes wrong with its plans."""
        parsed = Method.parse(method)
        loaded = load_checkpoint(
            self.hand, self.checkpoint(method), parsed, self.device, self.controller, self.draft
        )
        return LeRobotController(loaded, errors)

    def checkpoint(self, method: str) -> Path:
        """Return the checkpoint folder of a method."""
        return self._own.get(Method.parse(method).name, self.policy)

    @property
    def _own(self) -> dict[str, Path]:
        return {Method.parse(name).name: folder for name, folder in self.own}

    def check(self, methods: Sequence[str]) -> None:
        """Refuse what cannot run, before anything does.

        Raises:
            DexFlexError: If a checkpoint or controller is missing, a checkpoint did not learn what its method
                executes, or one is given for a method that is not compared.
        """
        compared = {Method.parse(name).name for name in methods}
        if strangers := [name for name in self._own if name not in compared]:
            raise DexFlexError(
                f"A checkpoint is given for {', '.join(strangers)}, but compared are {', '.join(methods)}."
            )
        for name in methods:
            check_checkpoint(self.hand, self.checkpoint(name), Method.parse(name), self.draft)
            Method.parse(name).weights(self.hand, self.controller)

    def version(self, method: str, task: str, **settings: Any) -> Version:
        """Return what decides a method's episodes on a task.

        Args:
            method: Name of the method.
            task: Name in `TASKS`.
            **settings: Whatever else decides, e.g. `batch_size`.

        Raises:
            DexFlexError: If its checkpoint or controller is missing or does not fit.
        """
        folder = self.checkpoint(method)
        part = check_checkpoint(self.hand, folder, Method.parse(method), self.draft)
        modules = (rollout.__name__, type(self).__module__, TASKS[task].module, *policy_modules(folder))
        return _version(self, method, modules, folder, executes=part, **settings)


@dataclass(frozen=True)
class AdaptedPolicies:
    """One checkpoint of any chunking policy of LeRobot, under `dexflex_adapter`, for all methods."""

    hand: Hand
    """The hand that the backbone was trained for."""
    backbone: Path
    """Folder `pretrained_model` of a policy that learned the whole action of a recorded dataset."""
    device: str = "cpu"
    controller: str = ""
    """Folder or hub id of the controller for interfaces that need one; empty is the shipped one."""

    def __call__(self, method: str, errors: CommandErrors = NO_ERRORS) -> "LeRobotController":
        """Put the method's interface under the policy, with what goes wrong with its plans."""
        loaded = load_adapter(self.hand, self.backbone, Method.parse(method), self.device, self.controller)
        return LeRobotController(loaded, errors)

    def check(self, methods: Sequence[str]) -> None:
        """Refuse what cannot run, before anything does.

        Raises:
            DexFlexError: If the checkpoint or a controller is missing.
        """
        check_backbone(self.backbone)
        for name in methods:
            Method.parse(name).weights(self.hand, self.controller)

    def version(self, method: str, task: str, **settings: Any) -> Version:
        """Return what decides a method's episodes on a task; see `LeRobotPolicies.version`."""
        check_backbone(self.backbone)
        modules = (rollout.__name__, type(self).__module__, TASKS[task].module, *adapter_modules())
        return _version(self, method, modules, self.backbone, **settings)


def _version(
    policies: LeRobotPolicies | AdaptedPolicies,
    name: str,
    modules: Sequence[str],
    folder: Path,
    **settings: Any,
) -> Version:
    method, hand = Method.parse(name), policies.hand
    weights = (folder, *method.weights(hand, policies.controller))
    settings |= {"device": policies.device, "hand": hand.signature, "method": method.name}
    return method_version((*modules, *method.modules), weights, **settings)


class LeRobotController:
    """A LeRobot policy under one interface, batched, its noise drawn per episode. Satisfies `Controller`.

    Args:
        loaded: A policy with an interface.
        errors: What goes wrong with its plans.
    """

    def __init__(self, loaded: LoadedPolicy, errors: CommandErrors = NO_ERRORS) -> None:
        self._policy, self._preprocess, self._postprocess = loaded
        execution = self._policy.execution
        self._observer = ObservedInterface(execution.interface)
        self._disturbed = DisturbedInterface(self._observer, errors) if errors else None
        execution.interface = self._disturbed or self._observer
        self._generators: list[torch.Generator] = []

    @property
    def motion(self) -> Motion | None:
        """See `Controller.motion`."""
        return self._observer.change

    @property
    def looks(self) -> bool:
        """See `Glancing.looks`: policies under the adapter may keep a history of images."""
        return self._policy.name != "dexflex_flow" or self._policy.execution.due

    def reset(self, seeds: Sequence[int]) -> None:
        """Start one episode per seed."""
        torch.manual_seed(seeds[0])  # For a policy under the adapter that samples: it draws its own noise.
        self._policy.reset()
        self._generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        if self._disturbed:
            self._disturbed.begin(seeds)

    @torch.inference_mode()
    def act(self, observation: dict[str, Any], task: str) -> NDArray[np.floating]:
        """See `Controller.act`; the same steps as LeRobot's own rollout."""
        from lerobot.envs.utils import preprocess_observation

        batch = preprocess_observation(observation)
        batch["task"] = [task] * len(self._generators)  # pyright: ignore[reportArgumentType]
        action = self._policy.select_action(self._preprocess(batch), **self._start())
        return self._postprocess(action).to("cpu").numpy()

    def _start(self) -> dict[str, Tensor]:
        """Draw a chunk of noise per episode in every step, so that step k sees the same in all interfaces."""
        if self._policy.name != "dexflex_flow":
            return {}
        shape = (self._policy.config.chunk_size, self._policy.plan.size)
        noise = torch.stack([torch.randn(shape, generator=g) for g in self._generators])
        return {"noise": noise.to(self._policy.config.device)}
