"""LeRobot checkpoints as controllers, loaded through LeRobot's own API."""

import contextlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.command_errors import NO_ERRORS, CommandErrors, PlanNoise, SupportRemoval
from lerobot_dexflex.evaluation.outcome import Motion
from lerobot_dexflex.evaluation.policy_files import check_policy_files, missing_files
from lerobot_dexflex.evaluation.provenance import checkpoint_digest
from lerobot_dexflex.interfaces import Interface, interface_entry
from lerobot_dexflex.interfaces.controller_folder import controller_digest, controller_of
from lerobot_dexflex.interfaces.explanation import Explanation
from lerobot_dexflex.interfaces.protocol import CommandSpace


@dataclass(frozen=True)
class LeRobotPolicies:
    """One checkpoint per action space, shared by its interfaces, unless they have their own."""

    joint: Path
    """Folder `pretrained_model` of the policy that learned joint targets."""
    draft: Path
    """Folder `pretrained_model` of the policy that learned commanded fingertips."""
    device: str = "cpu"
    controller: str = ""
    """Folder or hub id of the controller for interfaces that need one; empty is the shipped one."""
    errors: CommandErrors = NO_ERRORS
    """What goes wrong with the plans on their way to the interface."""
    own: tuple[tuple[str, Path], ...] = ()
    """Interfaces with a checkpoint of their own, e.g. trained on demonstrations recorded through them."""

    def __call__(self, interface: str) -> "LeRobotController":
        """Load the checkpoint that fits the interface."""
        folder = self.checkpoint(interface)
        return load_checkpoint(folder, interface, self.device, self.controller, self.errors)

    def checkpoint(self, interface: str) -> Path:
        """Return the checkpoint folder of an interface."""
        own = dict(self.own)
        if interface in own:
            return own[interface]
        return self.joint if interface_entry(interface).command_space == "joint" else self.draft

    def identity(self, interfaces: Sequence[str]) -> dict[str, str]:
        """Check the checkpoints and controllers that are needed; returns their content hashes and the device.

        Raises:
            DexFlexError: If one is missing, a checkpoint learned another action space, or one is given for an
                interface that is not compared.
        """
        if strangers := [name for name in dict(self.own) if name not in interfaces]:
            raise DexFlexError(
                f"A checkpoint is given for {', '.join(strangers)}, but compared are {', '.join(interfaces)}."
            )
        found = {}
        for name in interfaces:
            space = interface_entry(name).command_space
            folder = self.checkpoint(name)
            check_checkpoint(folder, space)
            found[f"checkpoint.{name if name in dict(self.own) else space}"] = checkpoint_digest(folder)
        return {
            **found,
            **controller_digests(interfaces, self.controller),
            **self.errors.identity(),
            "device": self.device,
        }


@dataclass(frozen=True)
class AdaptedPolicies:
    """One checkpoint of any chunking policy of LeRobot, under `dexflex_adapter`, for all interfaces."""

    backbone: Path
    """Folder `pretrained_model` of a policy that learned the whole action of a recorded dataset."""
    device: str = "cpu"
    controller: str = ""
    """Folder or hub id of the controller for interfaces that need one; empty is the shipped one."""
    errors: CommandErrors = NO_ERRORS
    """What goes wrong with the plans on their way to the interface."""

    def __call__(self, interface: str) -> "LeRobotController":
        """Put the interface under the policy."""
        return load_adapter(self.backbone, interface, self.device, self.controller, self.errors)

    def identity(self, interfaces: Sequence[str]) -> dict[str, str]:
        """Check that the checkpoint is there; returns content hashes and the device.

        Raises:
            DexFlexError: If the checkpoint or a controller is missing.
        """
        if missing := missing_files(self.backbone):
            raise DexFlexError(
                f"No checkpoint at {self.backbone}: {', '.join(missing)} not found. Give "
                "--backbone=<run>/checkpoints/last/pretrained_model of a policy that lerobot-train trained, "
                "e.g. with --policy.type=act."
            )
        check_policy_files(self.backbone)
        return {
            "backbone": checkpoint_digest(self.backbone),
            **controller_digests(interfaces, self.controller),
            **self.errors.identity(),
            "device": self.device,
        }


def controller_digests(interfaces: Sequence[str], controller: str) -> dict[str, str]:
    """Return the content hashes of the controllers that the interfaces need."""
    learned = [name for name in interfaces if interface_entry(name).learned]
    return {
        f"controller.{name}": controller_digest(controller_of(name, controller), name) for name in learned
    }


def check_checkpoint(folder: Path, space: CommandSpace) -> None:
    """Refuse a folder that is no checkpoint of this action space; reads its configuration only.

    Raises:
        DexFlexError: Says how to train what is missing.
    """
    interface = {"joint": "joint", "draft": "raw"}[space]
    remedy = (
        f"Give --{space}-policy=<run>/checkpoints/last/pretrained_model, or train one: lerobot-train "
        f"--policy.type=dexflex_flow --policy.interface={interface} --policy.push_to_hub=false "
        "--dataset.repo_id=lerobot-dexflex/place_hammer --dataset.root=datasets/place_hammer "
        f"--output_dir=outputs/train/{space}"
    )
    if missing := missing_files(folder):
        raise DexFlexError(f"No {space} checkpoint at {folder}: {', '.join(missing)} not found. {remedy}")
    check_policy_files(folder)
    config = json.loads((folder / "config.json").read_text())
    if config.get("action_space") != space:
        raise DexFlexError(
            f"The checkpoint {folder} ({config.get('type')}) learned the action space "
            f"{config.get('action_space')!r}, but this interface executes {space!r}. {remedy}"
        )


def load_checkpoint(
    checkpoint: Path, interface: str, device: str, controller: str = "", errors: CommandErrors = NO_ERRORS
) -> "LeRobotController":
    """Load a policy of our own.

    Args:
        checkpoint: Folder `pretrained_model`.
        interface: Overrides the checkpoint's interface.
        device: Torch device.
        controller: Overrides the checkpoint's controller; empty is the shipped one.
        errors: See `LeRobotController`.
    """
    # LeRobot takes seconds to import; only workers pay.
    from draccus.utils import DraccusException
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    check_policy_files(checkpoint)
    register_third_party_plugins()
    overrides = [f"--interface={interface}", f"--device={device}"]
    if interface_entry(interface).learned:
        overrides.append(f"--controller={controller_of(interface, controller)}")
    try:
        config = PreTrainedConfig.from_pretrained(checkpoint, cli_overrides=overrides)
    except (ValueError, DraccusException) as error:
        raise DexFlexError(
            f"{checkpoint / 'config.json'} holds settings that this version does not know: {error}"
        ) from error
    config.pretrained_path = checkpoint
    with contextlib.redirect_stdout(io.StringIO()):  # LeRobot announces every load; the bar would break.
        policy: Any = get_policy_class(config.type).from_pretrained(str(checkpoint), config=config)
    processors = make_pre_post_processors(
        config, str(checkpoint), preprocessor_overrides={"device_processor": {"device": device}}
    )
    return LeRobotController(policy.eval(), *processors, errors)


def load_adapter(
    backbone: Path, interface: str, device: str, controller: str = "", errors: CommandErrors = NO_ERRORS
) -> "LeRobotController":
    """Put an interface under another policy; arguments as for `load_checkpoint`."""
    from lerobot.configs import PreTrainedConfig
    from lerobot.policies.factory import get_policy_class, make_pre_post_processors
    from lerobot.utils.import_utils import register_third_party_plugins

    check_policy_files(backbone)
    register_third_party_plugins()  # The plugin stands above this library: it is asked for by name.
    make_config: Any = PreTrainedConfig.get_choice_class("dexflex_adapter")
    config = make_config(
        backbone_path=str(backbone), interface=interface, controller=controller, device=device
    )
    config.input_features = PreTrainedConfig.from_pretrained(backbone).input_features
    with contextlib.redirect_stdout(io.StringIO()):
        policy: Any = get_policy_class(config.type)(config)
    return LeRobotController(policy.eval(), *make_pre_post_processors(config), errors)


class LeRobotController:
    """A LeRobot policy under one interface, batched, with its noise drawn per episode.

    Args:
        policy: A policy with an interface.
        preprocess: LeRobot's pipeline before it.
        postprocess: LeRobot's pipeline after it.
        errors: What goes wrong with its plans.
    """

    def __init__(
        self, policy: Any, preprocess: Any, postprocess: Any, errors: CommandErrors = NO_ERRORS
    ) -> None:
        self._policy, self._preprocess, self._postprocess = policy, preprocess, postprocess
        execution = policy.execution
        self._observer = ObservedInterface(execution.interface)
        self._removal = SupportRemoval(self._observer, errors.removal) if errors.removal else None
        execution.interface = self._removal or self._observer
        self._noise = PlanNoise(errors.noise, self._observer.command_space) if errors.noise else None
        self._generators: list[torch.Generator] = []
        self._step = 0
        if noise := self._noise:
            begin = execution.begin
            execution.begin = lambda chunk: begin(noise.disturbed(chunk, self._step))

    @property
    def motion(self) -> Motion | None:
        """See `Controller.motion`."""
        return self._observer.motion

    def reset(self, seeds: Sequence[int]) -> None:
        """Start one episode per seed."""
        torch.manual_seed(seeds[0])  # For a policy under the adapter that samples: it draws its own noise.
        self._policy.reset()
        self._generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        if self._noise:
            self._noise.reset(seeds)
        if self._removal:
            self._removal.begin(seeds)
        self._step = 0

    @torch.inference_mode()
    def act(self, observation: dict[str, Any], task: str) -> NDArray[np.floating]:
        """See `Controller.act`; the same steps as LeRobot's own rollout."""
        from lerobot.envs.utils import preprocess_observation

        batch = preprocess_observation(observation)
        batch["task"] = [task] * len(self._generators)  # pyright: ignore[reportArgumentType]
        action = self._policy.select_action(self._preprocess(batch), **self._start())
        self._step += 1
        return self._postprocess(action).to("cpu").numpy()

    def _start(self) -> dict[str, Tensor]:
        """Draw a chunk of noise per episode in every step, so that step k sees the same in all interfaces."""
        if self._policy.name != "dexflex_flow":
            return {}
        shape = (self._policy.config.chunk_size, len(self._policy.normalization.columns))
        return {"noise": torch.stack([torch.randn(shape, generator=g) for g in self._generators])}


class ObservedInterface:
    """Passes all to an interface and remembers how it changed the last draft. Satisfies `Interface`."""

    def __init__(self, inner: Interface) -> None:
        self._inner = inner
        self.name: str = inner.name
        self.command_space: CommandSpace = inner.command_space
        self.motion: Motion | None = None

    @property
    def command(self) -> Tensor | None:
        """Executed commanded fingertips [m]. Shape (batch, 4, 3)."""
        return self._inner.command

    @property
    def explanation(self) -> Explanation | None:
        """Why the interface did what it did in the last step, if it tells."""
        return getattr(self._inner, "explanation", None)

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, or in all."""
        self.motion = None
        self._inner.reset(mask)

    def start(self, observation: Mapping[str, Tensor], initial: Tensor | None = None) -> Tensor:
        """Return the commanded fingertips before this step [m], (batch, 4, 3); see `Interface.start`."""
        return self._inner.start(observation, initial)

    def step(self, observation: Mapping[str, Tensor], draft: Tensor) -> Tensor:
        """Return the inner interface's joint targets; see `Interface.step`."""
        before = self._inner.start(observation)
        targets = self._inner.step(observation, draft)
        command = self._inner.command
        if self.command_space == "draft" and command is not None:
            parts = (draft[:, 0], command - before, command)
            self.motion = Motion(*(part.double().cpu().numpy() for part in parts))
        return targets
