"""`--policy.type=dexflex_adapter`: any chunking policy of LeRobot, executed through an action interface."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from draccus.utils import DraccusException
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.utils.constants import ACTION, OBS_STATE
from torch import Tensor, nn

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.policy_files import check_policy_files
from lerobot_dexflex.hands import Hand, get_hand
from lerobot_policy_dexflex.chunk_execution import ChunkExecution
from lerobot_policy_dexflex.compatibility import check_observation, check_offer, shapes
from lerobot_policy_dexflex.configuration_dexflex_adapter import NOT_TRAINED, DexflexAdapterConfig
from lerobot_policy_dexflex.controller_link import link_interface
from lerobot_policy_dexflex.interface_steps import InterfaceProcessorStep
from lerobot_policy_dexflex.normalization import action_columns, tip_numbers


class DexflexAdapterPolicy(PreTrainedPolicy):
    """A frozen backbone that plans chunks, and the interface that executes them.

    Args:
        config: Policy configuration; `input_features` are filled in by LeRobot.
        kwargs: Dataset statistics and metadata, unused: the backbone has its own.

    Raises:
        DexFlexError: If the backbone cannot be loaded, plans no chunks from one observation, or learned
            another action than the datasets of `dexflex-record` hold.
    """

    config_class = DexflexAdapterConfig  # pyright: ignore[reportAssignmentType]
    name = "dexflex_adapter"  # pyright: ignore[reportAssignmentType]
    config: DexflexAdapterConfig

    def __init__(self, config: DexflexAdapterConfig, **kwargs: Any) -> None:
        del kwargs
        super().__init__(config)
        offered = shapes(config.input_features)
        if OBS_STATE not in offered:
            raise DexFlexError(
                f"dexflex_adapter reads {OBS_STATE}. Got: {', '.join(sorted(offered))}. "
                "Evaluate it with --env.type=dexflex."
            )
        (n_joints,) = offered[OBS_STATE]
        hand = self._hand = get_hand(config.hand)
        settings = _backbone_config(config)
        _check(hand, settings, config, n_joints)
        # Some policies of LeRobot declare cameras that they fill with blanks themselves.
        self._inputs = {k: s for k, s in shapes(settings.input_features).items() if "empty_camera" not in k}
        check_offer(hand, self._inputs, offered)
        if Path(config.backbone_path).is_dir():
            check_policy_files(Path(config.backbone_path))
        backbone = get_policy_class(settings.type).from_pretrained(config.backbone_path, config=settings)
        self.backbone = backbone.eval().requires_grad_(False)
        self._before, self._after = make_pre_post_processors(
            settings,
            config.backbone_path,
            preprocessor_overrides={"device_processor": {"device": config.device}},
        )
        if any(isinstance(step, InterfaceProcessorStep) for step in self._after.steps):
            raise DexFlexError(
                "The backbone's post-processor has an interface of its own. Evaluate the backbone itself, "
                f"with --policy.path={config.backbone_path}, or name one without."
            )
        interface = link_interface(config)
        self._columns = action_columns(hand, n_joints, interface.command_space)
        n_arm = n_joints - hand.n_joints
        self.execution = ChunkExecution(interface, n_arm, config.n_action_steps)

    def get_optim_params(self) -> Iterable[nn.Parameter]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return nothing: the adapter is not trained."""
        return []

    def forward(self, batch: dict[str, Any]) -> tuple[Tensor, dict[str, float]]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Refuse: only the backbone is trained.

        Raises:
            DexFlexError: Always.
        """
        raise DexFlexError(NOT_TRAINED)

    def reset(self) -> None:
        """Begin a new episode in every row."""
        self.backbone.reset()
        self.execution.reset()

    @torch.no_grad()
    def predict_action_chunk(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, batch: Mapping[str, Any]
    ) -> Tensor:
        """Let the backbone plan; returns what the interface executes, in raw units.

        Args:
            batch: Observation in raw units.

        Returns:
            Arm joints [rad], then hand joints [rad] or fingertips [m]. Shape (batch, steps, ...).
        """
        planned = self.backbone.predict_action_chunk(self._before(dict(batch)))
        # Mixed precision ends here: the pipeline brings the plan to raw units, which bfloat16 would round.
        return self._after(planned.float()).to(batch[OBS_STATE].device)[..., self._columns]

    @torch.no_grad()
    def select_action(self, batch: Mapping[str, Any]) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return joint targets [rad] for this control step, shape (batch, joints); call it at every step.

        Args:
            batch: Observation in raw units; the backbone sees it only when a new chunk is planned.

        Raises:
            DexFlexError: If the observation lacks an input of the backbone or has it in another shape.
        """
        if self.execution.due:
            check_observation(self._hand, self._inputs, batch)
            self.execution.begin(self.predict_action_chunk(batch))
        return self.execution.step(batch)


def _backbone_config(config: DexflexAdapterConfig) -> PreTrainedConfig:
    remedy = "Name a folder `pretrained_model` or a hub id with --policy.backbone_path=..."
    if not config.backbone_path:
        raise DexFlexError(f"dexflex_adapter has no backbone. {remedy}")
    try:
        settings = PreTrainedConfig.from_pretrained(config.backbone_path)
    except (OSError, ValueError, DraccusException) as error:
        raise DexFlexError(f"{config.backbone_path!r} is no policy of LeRobot: {error}. {remedy}") from error
    settings.device = config.device
    return settings


def _check(hand: Hand, backbone: PreTrainedConfig, config: DexflexAdapterConfig, n_joints: int) -> None:
    if isinstance(backbone, DexflexAdapterConfig) or backbone.type == "dexflex_flow":
        raise DexFlexError(
            f"The backbone is a {backbone.type}, which has its own interface. Load it as the policy, with "
            f"--policy.path={config.backbone_path} --policy.interface={config.interface}."
        )
    feature = (backbone.output_features or {}).get(ACTION)
    tips = tip_numbers(hand)
    wanted = (n_joints + tips,)
    if feature is None or tuple(feature.shape) != wanted:
        got = None if feature is None else tuple(feature.shape)
        raise DexFlexError(
            f"The backbone's action must have shape {wanted}: {n_joints} joint targets, then {tips} "
            f"numbers of fingertips. Got {got}. "
            "Train it on a dataset that `dexflex-record` recorded for this robot."
        )
    if getattr(backbone, "n_obs_steps", 1) != 1:
        raise DexFlexError(
            "The backbone must plan from one observation. "
            f"Got n_obs_steps {backbone.n_obs_steps}; train it with --policy.n_obs_steps=1, e.g. ACT."
        )
    planned = getattr(backbone, "chunk_size", config.n_action_steps)
    if planned < config.n_action_steps:
        raise DexFlexError(
            f"`n_action_steps` must be at most the backbone's chunk of {planned}. "
            f"Got {config.n_action_steps}."
        )
