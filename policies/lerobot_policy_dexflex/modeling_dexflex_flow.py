"""`--policy.type=dexflex_flow`: flow matching to plans, of which every action interface executes its part."""

import copy
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn

from lerobot_dexflex.conventions import FINGERTIPS, GRAVITY, MEASURED, TACTILE
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.contacts import CONTACT_FORCE
from lerobot_dexflex.hands import get_hand
from lerobot_dexflex.interfaces.grip import loads_of
from lerobot_policy_dexflex.augmentation import jitter, shift_images, vary_light
from lerobot_policy_dexflex.chunk_execution import ChunkExecution
from lerobot_policy_dexflex.compatibility import (
    check_action,
    check_dataset,
    check_observation,
    check_told_environment,
    shapes,
    unread,
    warn_of_another_task,
)
from lerobot_policy_dexflex.configuration_dexflex_flow import DexflexFlowConfig
from lerobot_policy_dexflex.controller_link import link_interface
from lerobot_policy_dexflex.dataset_cache import cache_dataset
from lerobot_policy_dexflex.drafts import smoothed, without_squeeze
from lerobot_policy_dexflex.encoders import Observation
from lerobot_policy_dexflex.flow_network import LAST_TIME, FlowNetwork
from lerobot_policy_dexflex.lerobot_command import renamed, resuming, worker_processes
from lerobot_policy_dexflex.measured_tips import add_measured_tips
from lerobot_policy_dexflex.normalization import Normalization, compress_touch
from lerobot_policy_dexflex.plan import PlanLayout, PlanScale
from lerobot_policy_dexflex.weights import load_weights


class DexflexFlowPolicy(PreTrainedPolicy):
    """Flow-matching policy whose plans for the hand pass through `config.interface`.

    `forward` trains `network`; `update`, called by LeRobot after every optimiser step, moves its running
    average, and everything in evaluation mode uses that average. Both are saved. An interface's controller is
    no part of the policy: never trained, never saved, only named.

    Args:
        config: Policy configuration; `input_features` are filled in by LeRobot.
        dataset_stats: Statistics of the training dataset; None when a checkpoint is loaded.
        dataset_meta: Metadata of the training dataset; None outside of training.

    Raises:
        DexFlexError: If the dataset is of another robot, the interface executes a part of the plan that is
            not learned, or dataset, checkpoint and the environment of the running command do not fit.
    """

    config_class = DexflexFlowConfig  # pyright: ignore[reportAssignmentType]
    name = "dexflex_flow"  # pyright: ignore[reportAssignmentType]
    config: DexflexFlowConfig
    updates: Tensor
    weights: Tensor
    joint_noise: Tensor

    def __init__(
        self,
        config: DexflexFlowConfig,
        dataset_stats: Mapping[str, Any] | None = None,
        dataset_meta: Any = None,
        **kwargs: Any,
    ) -> None:
        del kwargs
        super().__init__(config)
        config.validate_features()
        hand, part = get_hand(config.hand), config.executed_part()
        self._hand = hand
        self._inputs = shapes(config.input_features)
        (n_joints,) = self._inputs[OBS_STATE]
        if dataset_meta is not None:
            self._use_dataset(dataset_meta)
        check_told_environment(hand, self._inputs)
        check_action(hand, n_joints, config.output_features)
        self.plan = PlanLayout(hand, n_joints - hand.n_joints, config.learns)
        self._part, self._executed = part, self.plan.columns(part)
        self.normalization = Normalization(hand, n_joints)
        self.scale = PlanScale(config.chunk_size, self.plan)
        self.network = FlowNetwork(
            hand,
            {key: tuple(feature.shape) for key, feature in config.image_features.items()},
            n_joints,
            self.plan.size,
            self.plan.n_arm,
            config.chunk_size,
            config.dim,
            config.n_layers,
            config.n_heads,
            config.mlp_ratio,
            config.n_keypoints,
            config.dropout,
        )
        self.average = copy.deepcopy(self.network).requires_grad_(False)
        self.register_buffer("updates", torch.zeros((), dtype=torch.int64))
        self.register_buffer("weights", self.plan.weights(), persistent=False)
        noise = torch.full((n_joints,), config.hand_noise)
        noise[: self.plan.n_arm] = config.arm_noise
        self.register_buffer("joint_noise", noise, persistent=False)
        interface = link_interface(config)
        self.execution = ChunkExecution(interface, self.plan.n_arm, config.n_action_steps)
        if dataset_stats is not None:
            self.begin_training(dataset_stats)

    def _use_dataset(self, meta: Any) -> None:
        check_dataset(self._hand, meta, self._inputs)
        self.config.tasks = [str(task) for task in meta.tasks.index]
        if self.config.cache_dataset:
            left_out = unread(meta.features, self._inputs)
            cache_dataset(meta, self.config.cache_gigabytes, worker_processes(), left_out)
        if MEASURED in self.config.learns:
            add_measured_tips(meta)

    @classmethod
    def from_pretrained(  # pyright: ignore[reportIncompatibleMethodOverride]
        cls,
        pretrained_name_or_path: str | Path,
        *,
        dataset_stats: Mapping[str, Any] | None = None,
        **kwargs: Any,
    ) -> "DexflexFlowPolicy":
        """Load a checkpoint; see `PreTrainedPolicy.from_pretrained`.

        With a dataset's statistics a training begins, with weights of the checkpoint and all else fresh,
        unless `lerobot-train --resume=true` goes on with it.
        """
        policy = super().from_pretrained(pretrained_name_or_path, **kwargs)
        if dataset_stats is not None and not resuming():
            policy.begin_training(dataset_stats)
        return policy

    def begin_training(self, dataset_stats: Mapping[str, Any]) -> None:
        """Take over a dataset's statistics; scale of plans and running average forget what came before."""
        self.normalization.fit(renamed(dataset_stats))
        self.scale.begin()
        self.updates.zero_()

    @classmethod
    def _load_as_safetensor(  # pyright: ignore[reportIncompatibleMethodOverride]
        cls, model: "DexflexFlowPolicy", model_file: str, map_location: str, strict: bool
    ) -> "DexflexFlowPolicy":
        """Load all weights: LeRobot would leave those at random that a file lacks, with a warning."""
        del map_location, strict
        load_weights(model, Path(model_file))
        return model

    def get_optim_params(self) -> Iterable[nn.Parameter]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return the trained weights; the running average is none of them."""
        return self.network.parameters()

    @torch.no_grad()
    def update(self) -> None:
        """Move the average toward the trained weights; quickly at first, while they are still poor."""
        self.updates += 1
        n = int(self.updates)
        decay = min(self.config.ema_decay, (1 + n) / (10 + n))
        for average, current in zip(self.average.parameters(), self.network.parameters(), strict=True):
            average.lerp_(current, 1 - decay)

    def reset(self) -> None:
        """Begin a new episode in every row: forget the chunk and the last command."""
        self.execution.reset()

    def forward(self, batch: dict[str, Any], reduction: str = "mean") -> tuple[Tensor, dict[str, float]]:
        """Return the error of the clean plan on `noise_draws` pairs of time and noise per sample.

        It is the flow-matching loss with weight (1 - t)^2. See `PlanLayout.weights` for that of the numbers.
        The error of what images alone tell of the arm is added, `sight_weight` times.

        Args:
            batch: Observation, `action` (batch, chunk_size, action) in raw units, `action_is_pad`; measured
                fingertips if these are learned, see `measured_tips.measured_tips`.
            reduction: `mean`, or `none` for one loss per sample.
        """
        network = self.network if self.training else self.average
        observation = self._observe(batch)
        valid = ~batch[f"{ACTION}_is_pad"]
        plans = self.plan.targets(batch)
        if self.training:
            self.scale.observe(plans, valid)
        x_1 = self.scale(plans)
        t, x_0 = self._draw(x_1)
        x_t = torch.lerp(x_0, x_1.expand_as(x_0), t[..., None, None])  # (draws, batch, chunk, size)
        context = network.encode(observation)
        clean = network.clean(x_t, t, context)
        error = ((clean - x_1).square() * self.weights).sum(-1).mean(0)  # (batch, chunk)
        unseen = self._unseen(network.arm_seen(context.images), batch) * valid[:, -1]
        weight = self.config.sight_weight
        per_sample = (error * valid).sum(1) / valid.sum(1)
        if reduction == "none":
            return per_sample + weight * unseen, {"flow_loss": per_sample.mean().item()}
        loss = (error * valid).sum() / valid.sum()
        sight_loss = unseen.sum() / valid[:, -1].sum().clamp(min=1)
        return loss + weight * sight_loss, {"flow_loss": loss.item(), "sight_loss": sight_loss.item()}

    def _unseen(self, arm_seen: Tensor, batch: Mapping[str, Any]) -> Tensor:
        """Return the squared error of the arm at the end of plans as images show it, unit scale (batch,)."""
        n, scale = self.plan.n_arm, self.normalization.state
        if not n:
            return arm_seen.new_zeros(len(arm_seen))
        arm = (batch[ACTION][:, -1, :n] - scale.mean[:n]) / scale.std[:n]
        return (arm_seen - arm).square().mean(-1)

    def _draw(self, x_1: Tensor) -> tuple[Tensor, Tensor]:
        """Draw times, stratified over the draws of a sample, and noise."""
        draws, batch = self.config.noise_draws, len(x_1)
        stratum = torch.arange(draws, device=x_1.device).unsqueeze(1)
        t = LAST_TIME * (stratum + torch.rand(draws, batch, device=x_1.device)) / draws
        return t, torch.randn(draws, *x_1.shape, device=x_1.device)

    def _observe(self, batch: Mapping[str, Any]) -> Observation:
        """Normalise an observation in raw units, augmented in training."""
        config, normalize = self.config, self.normalization
        images = {key: 2 * batch[key] - 1 for key in config.image_features}
        state, tips = batch[OBS_STATE], batch[FINGERTIPS]
        missing = torch.zeros(len(state), dtype=torch.bool, device=state.device)
        if self.training:
            images = {
                key: shift_images(vary_light(image, config.brightness), config.image_shift)
                for key, image in images.items()
            }
            state, tips = jitter(state, self.joint_noise), jitter(tips, config.fingertip_noise)
            missing = torch.rand(len(state), device=state.device) < config.touch_dropout
        return Observation(
            images,
            normalize.state(state),
            normalize.fingertips(tips).unflatten(-1, (self._hand.n_fingers, 3)),
            batch[GRAVITY],
            compress_touch(self._hand, batch[TACTILE], config.taxel_full_scale),
            missing,
        )

    @torch.no_grad()
    def predict_plan(self, batch: Mapping[str, Any], noise: Tensor | None = None) -> Tensor:
        """Integrate the flow from noise to a plan of all learned parts, absolute and in raw units.

        Args:
            batch: Observation in raw units.
            noise: Standard normal start; drawn if None. Shape (batch, chunk_size, plan.size).

        Returns:
            Joints [rad] and fingertips [m] as `PlanLayout` says. Shape of `noise`.
        """
        shape = (len(batch[OBS_STATE]), self.config.chunk_size, self.plan.size)
        if noise is None:
            noise = torch.randn(shape, device=batch[OBS_STATE].device)
        elif tuple(noise.shape) != shape:
            raise DexFlexError(f"`noise` must have shape {shape}. Got {tuple(noise.shape)}.")
        network = self.network if self.training else self.average
        observation = self._observe(batch)
        context = network.encode(observation)
        x = noise.unsqueeze(0)
        for k in range(self.config.euler_steps):
            t = x.new_full(x.shape[:2], k / self.config.euler_steps)
            x = x + (network.clean(x, t, context) - x) / (self.config.euler_steps - k)
        return smoothed(self.scale.inverse(x[0]), self.config.smoothing)

    @torch.no_grad()
    def predict_action_chunk(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, batch: Mapping[str, Any], noise: Tensor | None = None
    ) -> Tensor:
        """Return the interface's part of a plan, in raw units; see `without_squeeze`.

        Args:
            batch: Observation in raw units.
            noise: See `predict_plan`.

        Returns:
            Arm joints [rad], then hand joints [rad] or fingertips [m]. Shape (batch, chunk_size, ...).
        """
        chunk = self.predict_plan(batch, noise)[..., self._executed]
        if self._part != MEASURED:
            return chunk
        n_arm, touching = self.plan.n_arm, loads_of(self._hand, batch[TACTILE]) > CONTACT_FORCE
        tips = without_squeeze(chunk[..., n_arm:], batch[FINGERTIPS], touching)
        return torch.cat([chunk[..., :n_arm], tips], -1)

    @torch.no_grad()
    def select_action(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, batch: Mapping[str, Any], noise: Tensor | None = None
    ) -> Tensor:
        """Return joint targets [rad] for this control step, shape (batch, joints); call it at every step.

        Args:
            batch: Observation in raw units; images are read only when a new chunk is planned.
            noise: Start of the flow if this step plans a chunk; see `predict_plan`.

        Raises:
            DexFlexError: If the observation lacks an input or has it in another shape.
        """
        if self.execution.due:
            check_observation(self._hand, self._inputs, batch)
            warn_of_another_task(self.config.tasks, batch.get("task"))
            self.execution.begin(self.predict_action_chunk(batch, noise))
        return self.execution.step(batch)
