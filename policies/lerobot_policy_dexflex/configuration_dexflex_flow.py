"""Configuration of `--policy.type=dexflex_flow`."""

from dataclasses import dataclass, field

from draccus.utils import ParsingError
from lerobot.configs import NormalizationMode, PreTrainedConfig
from lerobot.optim import AdamWConfig
from lerobot.optim.schedulers import CosineDecayWithWarmupSchedulerConfig

from lerobot_dexflex.conventions import DRAFTS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.evaluation.plan_parts import OLD_LAYOUT, PARTS, executed_part
from lerobot_dexflex.interfaces import Method
from lerobot_policy_dexflex.configuration_shared import (
    check_draft,
    check_hand,
    check_interface,
    no_normalization,
)

_INPUTS = ("observation.state", "observation.tactile", "observation.fingertips", "observation.gravity")
_WHOLE_RUN = 1_000_000


@PreTrainedConfig.register_subclass("dexflex_flow")
@dataclass
class DexflexFlowConfig(PreTrainedConfig):
    """Flow matching from images, touch and joints to plans that serve all interfaces.

    The network needs no download and trains on one CPU core. All normalisation happens inside the policy,
    because the action interface needs raw units.
    """

    # What is learned and how it is executed
    hand: str = "leap"
    """The hand, a name of `lerobot_dexflex.hands`: that of the dataset and of the environment."""
    interface: str = "joint"
    """How the hand is commanded: `joint`, `raw`, `press`, `dexgen`, `dexflex` or another method of
    `lerobot_dexflex.interfaces`, such as `dexflex-notouch@0.7`. Switchable at evaluation: each executes its
    part of the same plan, `joint` the hand's joint targets, the others the fingertips that `draft` names."""
    controller: str = ""
    """Folder or hub id of the frozen controller of `dexgen` and `dexflex`; empty is the repository's own."""
    controller_digest: str = ""
    """Interface and content hash of the controller that a checkpoint was saved with; set by the policy."""
    learns: list[str] | str = field(default_factory=lambda: list(PARTS))
    """Which parts of the hand's plan are learned beside the arm's joint targets: `joint`, its joint targets;
    `commanded`, the fingertips of the dataset's action, which press; `measured`, where they were one step
    later, which holds no force. Decided in a new training and saved in the checkpoint."""
    draft: str = ""
    """Which fingertips are executed by interfaces that read drafts: `measured` or `commanded`. Empty: the
    measured ones, or the commanded ones if only these were learned."""
    action_space: str = ""
    """Only checkpoints of the older layout have one; draccus would refuse them without saying why."""
    tasks: list[str] = field(default_factory=list)
    """Instructions in the training dataset; set by the policy, which warns when it is asked for another."""
    chunk_size: int = 24
    """Control steps predicted at once."""
    n_action_steps: int = 16
    """Control steps executed before planning again."""

    # Network
    dim: int = 128
    n_layers: int = 3
    n_heads: int = 4
    mlp_ratio: int = 2
    n_keypoints: int = 32
    """Image points tracked per camera."""
    taxel_full_scale: float = 1.0
    """Taxel force that enters the network as 1 [N]; fixed by the sensor, never fitted to a frame."""

    # Flow
    noise_draws: int = 2
    """Pairs of time and noise per sample and step; they share the image encoder, the most expensive part."""
    euler_steps: int = 8
    """Integration steps from noise to a chunk, at most 10."""

    smoothing: int = 5
    """Control steps over which plans are averaged, an odd number; 1 leaves them as they are sampled. Samples
    shiver by millimetres from step to step, which loosens every grip, whatever executes them."""

    # Augmentation and regularisation, in training only
    dropout: float = 0.1
    """Share of the outputs of every attention and MLP of the transformer that is hidden: 50 demonstrations
    are few enough to be learned by heart."""
    image_shift: int = 0
    """Largest random shift of an image [pixel]. Zero by default: a pixel of a 96 x 96 view is several
    millimetres wide, as much as a grasp forgives."""
    brightness: float = 0.1
    """Standard deviation of a random brightness factor and contrast factor per image."""
    arm_noise: float = 0.03
    """Standard deviation of noise on the arm's measured joints [rad]. In demonstrations the arm is already
    where the tool makes it go; a policy that believes it does not look, and never corrects its own errors."""
    hand_noise: float = 0.01
    """The same on the hand's measured joints [rad]."""
    fingertip_noise: float = 0.001
    """The same on the measured fingertips [m]."""
    sight_weight: float = 10.0
    """Weight of a second loss: images alone must tell where the arm will be at the end of the plan."""
    touch_dropout: float = 0.1
    """Probability of hiding all taxels of a sample, so that the policy survives without touch."""

    # Optimisation
    ema_decay: float = 0.999
    """Decay of the running average of the weights, which acts at evaluation."""
    optimizer_lr: float = 2e-3
    optimizer_weight_decay: float = 1e-2
    optimizer_grad_clip_norm: float = 1.0
    warmup_fraction: float = 0.02
    """Part of the training over which the learning rate rises; it then falls along a cosine to 1 %."""

    # Data loading
    cache_dataset: bool = True
    """Keep the decoded dataset in memory while training in this process (`num_workers=0`); see
    `lerobot_policy_dexflex.dataset_cache`."""
    cache_gigabytes: float = 4.0
    """Larger datasets are left to LeRobot's own loader."""

    normalization_mapping: dict[str, NormalizationMode] = field(default_factory=no_normalization)

    def __post_init__(self) -> None:
        """Refuse values that cannot work.

        Raises:
            ParsingError: draccus hides the message of any ValueError from a configuration, but not this one.
        """
        super().__post_init__()
        if self.action_space:
            raise ParsingError(OLD_LAYOUT)
        check_hand(self.hand)
        check_interface(self.interface)
        check_draft(self.draft, (*DRAFTS, ""))
        if isinstance(
            self.learns, str
        ):  # Beside a --config_path draccus reads lists as JSON: names unquoted.
            self.learns = [name.strip() for name in self.learns.strip("[] ").split(",") if name.strip()]
        if not self.learns or not set(self.learns) <= set(PARTS):
            raise ParsingError(
                f"`learns` must name one or more of {', '.join(PARTS)}, as in --policy.learns=[measured]. "
                f"Got {self.learns}."
            )
        self.learns = [part for part in PARTS if part in self.learns]
        if not 1 <= self.n_action_steps <= self.chunk_size:
            raise ParsingError(
                f"`n_action_steps` must be between 1 and `chunk_size` ({self.chunk_size}). "
                f"Got {self.n_action_steps}."
            )
        if self.chunk_size % 2:
            raise ParsingError(f"`chunk_size` must be even. Got {self.chunk_size}.")
        if self.smoothing < 1 or self.smoothing % 2 == 0:
            raise ParsingError(f"`smoothing` must be odd and at least 1. Got {self.smoothing}.")
        if self.dim % self.n_heads:
            raise ParsingError(f"`dim` must be a multiple of `n_heads` ({self.n_heads}). Got {self.dim}.")
        for name in ("noise_draws", "euler_steps", "n_layers", "n_keypoints"):
            if getattr(self, name) < 1:
                raise ParsingError(f"`{name}` must be at least 1. Got {getattr(self, name)}.")
        if self.euler_steps > 10:
            raise ParsingError(
                f"`euler_steps` must be at most 10, as flow times beyond 0.9 are not trained. "
                f"Got {self.euler_steps}."
            )
        if not 0 <= self.dropout < 1:
            raise ParsingError(f"`dropout` must be in [0, 1). Got {self.dropout}.")
        for name in ("touch_dropout", "ema_decay", "warmup_fraction"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParsingError(f"`{name}` must be in [0, 1]. Got {getattr(self, name)}.")
        if any(mode is not NormalizationMode.IDENTITY for mode in self.normalization_mapping.values()):
            raise ParsingError(
                "`normalization_mapping` must be IDENTITY for every type: the policy normalises inside. "
                f"Got {self.normalization_mapping}."
            )

    def executed_part(self) -> str:
        """Return the part of the plan that the interface executes.

        Raises:
            DexFlexError: If it was not learned.
        """
        return executed_part(self.learns, Method.parse(self.interface), self.draft)

    @property
    def observation_delta_indices(self) -> None:
        """One observation, the current one."""
        return

    @property
    def action_delta_indices(self) -> list[int]:
        """The chunk, beginning at the current step."""
        return list(range(self.chunk_size))

    @property
    def reward_delta_indices(self) -> None:
        """No rewards."""
        return

    def get_optimizer_preset(self) -> AdamWConfig:
        """Return AdamW with gradient clipping."""
        return AdamWConfig(
            lr=self.optimizer_lr,
            weight_decay=self.optimizer_weight_decay,
            grad_clip_norm=self.optimizer_grad_clip_norm,
        )

    def get_scheduler_preset(self) -> CosineDecayWithWarmupSchedulerConfig:
        """Return a cosine with warm-up over the whole run: LeRobot shrinks it to the number of steps."""
        return CosineDecayWithWarmupSchedulerConfig(
            num_warmup_steps=int(self.warmup_fraction * _WHOLE_RUN),
            num_decay_steps=_WHOLE_RUN,
            peak_lr=self.optimizer_lr,
            decay_lr=0.01 * self.optimizer_lr,
        )

    def validate_features(self) -> None:
        """Refuse a dataset or environment without the observations that the policy reads.

        Raises:
            DexFlexError: If one is missing, or images have a size that the network cannot take.
        """
        have = sorted(self.input_features or {})
        missing = [key for key in _INPUTS if key not in have]
        if missing or not self.image_features:
            missing += [] if self.image_features else ["observation.images.<camera>"]
            raise DexFlexError(
                f"dexflex_flow reads {', '.join(_INPUTS)} and at least one camera. Missing: "
                f"{', '.join(missing)}. Got: {', '.join(have)}. Record the dataset with `dexflex-record`."
            )
        for key, feature in self.image_features.items():
            channels, height, width = feature.shape
            if channels != 3 or height % 8 or width % 8:
                raise DexFlexError(
                    "dexflex_flow takes images of 3 channels whose height and width are multiples of 8. "
                    f"Got {key} of {channels} channels, {height} x {width}. "
                    "Record the dataset again with such images."
                )
