"""Configuration of `--policy.type=dexflex_adapter`."""

from dataclasses import dataclass, field

from draccus.utils import ParsingError
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig

from lerobot_dexflex.conventions import COMMANDED, DRAFTS
from lerobot_dexflex.errors import DexFlexError
from lerobot_policy_dexflex.configuration_shared import (
    check_draft,
    check_hand,
    check_interface,
    no_normalization,
)

NOT_TRAINED = (
    "dexflex_adapter is not trained. Train its backbone with --policy.type=act or another policy of LeRobot, "
    "then name it with --policy.backbone_path=<folder or hub id>."
)


@PreTrainedConfig.register_subclass("dexflex_adapter")
@dataclass
class DexflexAdapterConfig(PreTrainedConfig):
    """An action interface under a policy that LeRobot trained on a dataset of `dexflex-record`.

    The backbone learned the whole action: joint targets, then fingertips. The interface decides which of the
    two is executed, so that one checkpoint serves all of them.
    """

    backbone_path: str = ""
    """Folder or hub id of the policy below: a `pretrained_model` of ACT or another policy that plans chunks
    from one observation."""
    hand: str = "leap"
    """The hand, a name of `lerobot_dexflex.hands`: that of the backbone's dataset and of the environment."""
    interface: str = "raw"
    """How the hand is commanded: `joint`, `raw`, `press`, `dexgen`, `dexflex` or another method of
    `lerobot_dexflex.interfaces`."""
    draft: str = COMMANDED
    """Which fingertips the backbone learned: `commanded`, as recorded datasets' actions hold them, or
    `measured`. Execution is the same."""
    controller: str = ""
    """Folder or hub id of the frozen controller of `dexgen` and `dexflex`; empty is the repository's own."""
    controller_digest: str = ""
    """Interface and content hash of the controller; set by the policy."""
    n_action_steps: int = 8
    """Control steps executed before planning again."""
    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=no_normalization)

    def __post_init__(self) -> None:
        """Refuse values that cannot work.

        Raises:
            ParsingError: draccus hides the message of any ValueError from a configuration, but not this one.
        """
        super().__post_init__()
        check_hand(self.hand)
        check_interface(self.interface)
        check_draft(self.draft, DRAFTS)
        if self.n_action_steps < 1:
            raise ParsingError(f"`n_action_steps` must be at least 1. Got {self.n_action_steps}.")

    @property
    def observation_delta_indices(self) -> None:
        """One observation, the current one."""
        return

    @property
    def action_delta_indices(self) -> None:
        """No actions: the adapter is not trained."""
        return

    @property
    def reward_delta_indices(self) -> None:
        """No rewards."""
        return

    def get_optimizer_preset(self) -> AdamWConfig:
        """Refuse: only the backbone is trained."""
        raise DexFlexError(NOT_TRAINED)

    def get_scheduler_preset(self) -> None:
        """No schedule."""
        return

    def validate_features(self) -> None:
        """The backbone knows what it needs."""
