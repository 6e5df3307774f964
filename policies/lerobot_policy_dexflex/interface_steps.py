"""An action interface as steps of LeRobot's pipelines, below any policy that says where fingertips go.

An interface needs the hand's measured joints and touch at every control step, but LeRobot 0.6.1 hands a
post-processor the action alone: its converter makes a transition without observation
(`policy_action_to_transition` in `lerobot/processor/converters.py`), in evaluation as in rollout. Hence two
steps:

- `dexflex_observation_processor` in the pre-processor, before normalisation, remembers the observation in
  raw units;
- `dexflex_interface_processor` in the post-processor, after unnormalisation, executes the action with it.

LeRobot loads the two pipelines apart and gives plugins no place to join them again (it re-links only its own
relative actions, `policies/factory.py`). So the steps meet by a name that both save, `link`, within a thread:
one thread runs pre-processor, policy and post-processor in turn. Each observation serves one action, so that
a control loop that skips one is refused, not executed with an old one. Where the transition does hold an
observation, as in a pipeline of one's own around a glove, that is used, and the second step suffices.

Batches: a row is a hand. `reset()`, which LeRobot's rollout calls, begins a new episode in all rows. Its
evaluation never calls it; there, rows whose `observation.frame_index` is 0 begin one, and
`--env.type=dexflex` offers this key. Under another environment offer it too, or reset the pipelines between
episodes yourself.

Not served: LeRobot's RTC and its asynchronous server, which post-process a whole chunk at one observation,
and `max_parallel_tasks` above 1, which shares one memory between environments.
"""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

import torch
from lerobot.configs import PipelineFeatureType, PolicyFeature
from lerobot.lerobot_types import EnvTransition, TransitionKey
from lerobot.processor import (
    DeviceProcessorStep,
    NormalizerProcessorStep,
    PolicyProcessorPipeline,
    ProcessorStep,
    ProcessorStepRegistry,
)
from lerobot.utils.constants import ACTION
from torch import Tensor

from lerobot_dexflex.conventions import COMMANDED, DRAFTS, FINGERTIPS, GRAVITY, STATE, TACTILE
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces import Interface, Method
from lerobot_policy_dexflex.controller_link import open_interface
from lerobot_policy_dexflex.frame_index import FRAME_INDEX
from lerobot_policy_dexflex.normalization import action_sizes

OBSERVATION_STEP, INTERFACE_STEP = "dexflex_observation_processor", "dexflex_interface_processor"
_KEYS = (STATE, TACTILE, FINGERTIPS, GRAVITY, FRAME_INDEX)

Features = dict[PipelineFeatureType, dict[str, PolicyFeature]]


class _Seen(threading.local):
    """Observations that wait for their action, by link."""

    def __init__(self) -> None:
        self.by_link: dict[str, dict[str, Tensor] | None] = {}


_seen = _Seen()


@ProcessorStepRegistry.register(OBSERVATION_STEP)
@dataclass
class RememberObservationProcessorStep(ProcessorStep):
    """Remembers what an interface reads of the observation; changes nothing."""

    link: str = "policy"
    """Name under which the post-processor finds the observation. Give pairs of pipelines that take turns
    within one control step different ones."""

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Remember the observation of a transition, in place of one that was not used."""
        _seen.by_link[self.link] = _readings(transition)
        return transition

    def get_config(self) -> dict[str, str]:
        """Return what is saved."""
        return {"link": self.link}

    def reset(self) -> None:
        """Forget the observation."""
        _seen.by_link.pop(self.link, None)

    def transform_features(self, features: Features) -> Features:
        """Return the features as they are."""
        return features


@ProcessorStepRegistry.register(INTERFACE_STEP)
@dataclass
class InterfaceProcessorStep(ProcessorStep):
    """Turns an action that holds fingertips into joint targets; see `ActionExecution.step`.

    Raises:
        DexFlexError: If an option is none, or the controller is missing or has another content than the one
            that this step was saved with. (`from_pretrained` wraps it in a ValueError with the same text.)
    """

    interface: str = "raw"
    """How the hand is commanded: `raw`, `press`, `dexgen`, `dexflex` or another method of
    `lerobot_dexflex.interfaces`."""
    draft: str = COMMANDED
    """Which fingertips the policy learned: `commanded`, as recorded datasets' actions hold them, or
    `measured`. Execution is the same."""
    controller: str = ""
    """Folder or hub id of the frozen controller of `dexgen` and `dexflex`; empty is the repository's own.
    Saved by name, never copied."""
    controller_digest: str = ""
    """Interface and content hash of the controller; set by the step. Empty accepts any."""
    link: str = "policy"
    """As that of the observation's step."""
    hand: str = "leap"
    """The hand, a name of `lerobot_dexflex.hands`."""

    def __post_init__(self) -> None:
        """Make the interface."""
        # LeRobot imports this module with every command; the execution loads MuJoCo.
        from lerobot_policy_dexflex.action_execution import ActionExecution

        if self.draft not in DRAFTS:
            raise DexFlexError(f"`draft` must be {' or '.join(DRAFTS)}. Got {self.draft!r}.")
        interface, change = open_interface(self)
        if change:
            raise DexFlexError(
                f"{change}. Name the original with `controller`, a folder or hub id, or accept this one with "
                f"an empty `controller_digest`, as overrides={{'{INTERFACE_STEP}': {{...}}}}."
            )
        self._execution = ActionExecution(Method.parse(self.interface), interface)

    @property
    def action_interface(self) -> Interface:
        """What executes; of learned ones, `explanation` tells why they did what they did."""
        return self._execution.interface

    def __call__(self, transition: EnvTransition) -> EnvTransition:
        """Replace the action by joint targets [rad], shape (batch, joints).

        Raises:
            DexFlexError: If no observation came with the action or before it, or it does not fit.
        """
        action = transition.get(TransitionKey.ACTION)
        if not isinstance(action, Tensor):
            raise DexFlexError(f"{INTERFACE_STEP} executes a tensor of actions. Got {type(action).__name__}.")
        observation = _readings(transition) or _seen.by_link.pop(self.link, None)
        if observation is None:
            raise DexFlexError(
                f"{INTERFACE_STEP} has no observation for this action. Put {OBSERVATION_STEP} with link "
                f"{self.link!r} into the pre-processor (`set_interface` does) and run that once before every "
                "action. LeRobot's asynchronous server, which executes chunks without looking, is not served."
            )
        targets = self._execution.step(observation, action)
        return cast(EnvTransition, {**transition, TransitionKey.ACTION: targets})

    def get_config(self) -> dict[str, str]:
        """Return what is saved: names and a hash."""
        names = ("interface", "draft", "controller", "controller_digest", "link", "hand")
        return {name: getattr(self, name) for name in names}

    def reset(self, mask: Tensor | None = None) -> None:
        """Begin a new episode in the rows of `mask`, shape (batch,) bool, or, as LeRobot does, in all."""
        self._execution.reset(mask)

    def transform_features(self, features: Features) -> Features:
        """Return the features with joint targets as the action."""
        actions = features.get(PipelineFeatureType.ACTION, {})
        feature = actions.get(ACTION)
        hand, space = get_hand(self.hand), self.action_interface.command_space
        for n_joints in sorted({len(task.joints(hand)) for task in TASKS.values()}):
            if feature is not None and feature.shape[-1] in action_sizes(hand, n_joints, space):
                joints = {ACTION: replace(feature, shape=(n_joints,))}
                return {**features, PipelineFeatureType.ACTION: {**actions, **joints}}
        return features


def set_interface(
    preprocessor: PolicyProcessorPipeline,
    postprocessor: PolicyProcessorPipeline,
    interface: str = "dexflex",
    draft: str = COMMANDED,
    controller: str = "",
    link: str = "policy",
    hand: str = "leap",
) -> InterfaceProcessorStep:
    """Put an interface into a policy's pipelines, in place of one that is there; returns its step.

    Args:
        preprocessor: Gets the step that remembers, before the first normalisation.
        postprocessor: Gets the step that executes, as the last but for a move to another device.
        interface: See `InterfaceProcessorStep`, as for the others.
        draft: Which fingertips the policy learned.
        controller: Folder or hub id.
        link: Joins the two steps.
        hand: Name of the hand.

    Raises:
        DexFlexError: If an option is none or the controller is missing.
    """
    step = InterfaceProcessorStep(interface, draft, controller, link=link, hand=hand)
    before = [each for each in preprocessor.steps if not isinstance(each, RememberObservationProcessorStep)]
    after = [each for each in postprocessor.steps if not isinstance(each, InterfaceProcessorStep)]
    scaled = (k for k, each in enumerate(before) if isinstance(each, NormalizerProcessorStep))
    before.insert(next(scaled, len(before)), RememberObservationProcessorStep(link))
    moved = bool(after) and isinstance(after[-1], DeviceProcessorStep)
    after.insert(len(after) - moved, step)
    preprocessor.steps, postprocessor.steps = before, after
    return step


def _readings(transition: EnvTransition) -> dict[str, Tensor] | None:
    """Return what interfaces read of a transition's observation, with a batch dimension, or None."""
    observation = transition.get(TransitionKey.OBSERVATION)
    if not isinstance(observation, Mapping):
        return None
    readings = {key: torch.as_tensor(observation[key]) for key in _KEYS if key in observation}
    return {key: value if value.ndim > 1 else value[None] for key, value in readings.items()}
