"""What a controller was built for: hand, rate, meaning of a draft, and the sizes of its networks."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from lerobot_dexflex.controller.layout import BETWEEN, Layout, layout_of
from lerobot_dexflex.conventions import DRAFT_HORIZON
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand

FRAMES = (0, 1, 3, 7)
"""Steps back at which joints, fingertips and touch are seen."""
SLOW_STRIDE, SLOW_SAMPLES = 4, 8
"""The slow window: every fourth step, eight of them, newest first."""
DRAFT_HISTORY = 8
"""Steps before this one whose drafts are seen."""
CHECKSUMS = "checksums"
"""Key of `config.json` beside the configuration: SHA-256 of the weights by file name."""
DRAFT_DEFINITION = "offset_from_measured"
"""What a draft says: where fingertips should be, minus where they are measured."""
_IDENTITY = {
    "format": 4,
    "rate": 20.0,
    "horizon": DRAFT_HORIZON,
    "draft_definition": DRAFT_DEFINITION,
    "frames": FRAMES,
    "slow_stride": SLOW_STRIDE,
    "slow_samples": SLOW_SAMPLES,
    "draft_history": DRAFT_HISTORY,
}
"""What a checkpoint and this code must agree on; beside it a checkpoint names a hand that the code knows."""


@dataclass(frozen=True)
class ControllerConfig:
    """Everything needed to rebuild a controller's networks.

    Raises:
        DexFlexError: If the configuration is of an unknown hand or of another rate or format than this code
            serves.
    """

    format: int = 4
    """Version of the checkpoint's layout."""
    hand: str = "leap"
    """The hand, by its name, or hands with `+` between them; decides fingers, joints and taxels."""
    rate: float = 20.0
    """Control rate [Hz]."""
    horizon: int = DRAFT_HORIZON
    """Control steps in a draft and in every candidate."""
    draft_definition: str = DRAFT_DEFINITION
    """What a step of a draft is: where the fingertips should be, minus where they are measured now, in the
    palm frame [m]."""
    frames: tuple[int, ...] = FRAMES
    """Steps back at which joints, fingertips and touch are seen."""
    slow_stride: int = SLOW_STRIDE
    """Steps between two samples of the slow window."""
    slow_samples: int = SLOW_SAMPLES
    """Samples of the slow window."""
    draft_history: int = DRAFT_HISTORY
    """Steps before this one whose drafts are seen."""

    use_touch: bool = True
    """Whether the networks ever see touch; without it every finger has the learned missing token."""
    use_slow: bool = True
    """Whether the networks ever see the slow token."""

    touch_scale: float = 0.1
    """Force at which the compression of touch turns from linear to logarithmic [N]."""
    tip_scale: float = 0.04
    """Fingertip positions are divided by this [m]."""
    joint_step_scale: float = 0.05
    """Changes of joints since an earlier frame are divided by this [rad]."""
    tip_step_scale: float = 0.004
    """Changes of fingertips since an earlier frame are divided by this [m]."""
    force_scale: float = 2.0
    """The decoder's forces are multiples of this [N]."""
    squeeze_scale: float = 0.01
    """Drafts and squeezes are divided by this in the splitter [m]."""
    largest_force: float = 8.0
    """Bound of a finger's force [N], whatever its motors could exert."""

    body_width: int = 96
    """Width of the proprioceptive latent p."""
    contact_width: int = 64
    """Width of the global contact latent c."""
    finger_width: int = 48
    """Width of a finger's token."""
    slow_levels: tuple[int, ...] = (8, 5)
    """Levels of the finite scalar quantisation of the slow token."""
    slow_width: int = 16
    """Width of the slow token's embedding."""
    prior_width: int = 96
    """Width of the prior's tokens."""
    prior_layers: int = 2
    """Transformer blocks of the prior."""
    prior_heads: int = 4
    """Attention heads of the prior."""
    world_width: int = 256
    """Hidden width of the world model."""
    score_width: int = 192
    """Hidden width of the score."""
    decoder_width: int = 192
    """Hidden width of the decoder."""
    splitter_width: int = 128
    """Hidden width of the splitter."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, list):
                object.__setattr__(self, item.name, tuple(value))
        for name in _IDENTITY:
            _check_identity(name, getattr(self, name))
        for item in fields(self):
            _check_value(item.name, item.type, getattr(self, item.name))
        layout_of(self.hand)

    @property
    def layout(self) -> Layout:
        """How the networks see the fingers of the hand, or of the hands."""
        return layout_of(self.hand)

    @property
    def n_fingers(self) -> int:
        """Number of fingers that the networks see."""
        return self.layout.n_fingers

    @property
    def latent_width(self) -> int:
        """Width of z = [p, c, finger tokens], which the world model predicts."""
        return self.body_width + self.contact_width + self.n_fingers * self.finger_width

    @property
    def feature_width(self) -> int:
        """Width of z and the slow token together: all that the networks know of a state."""
        return self.latent_width + self.slow_width

    @property
    def chunk_width(self) -> int:
        """Numbers in a chunk."""
        return self.horizon * self.n_fingers * 3

    @property
    def finger_chunk_width(self) -> int:
        """Numbers in one finger's part of a chunk."""
        return self.horizon * 3

    def check(self, hand: Hand, source: str = "The controller") -> None:
        """Refuse to move another hand than the one that the controller was trained for.

        Args:
            hand: The robot's.
            source: Which controller it is, for the message.

        Raises:
            DexFlexError: If the hands differ.
        """
        if hand.name not in self.hand.split(BETWEEN):
            raise DexFlexError(
                f"{source} was trained for '{self.hand}', but the robot is '{hand.name}'. "
                f"Give --policy.controller=<folder or hub id> of one for '{hand.name}', or train it: "
                f"dexflex-corpus --hand={hand.name} --output=<corpus>, then dexflex-train --corpus=<corpus>."
            )

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], source: str = "the configuration") -> "ControllerConfig":
        """Build from plain values, as in `config.json`.

        Args:
            values: Every name of `_IDENTITY`, `hand` and any other field.
            source: Where the values come from, for messages.

        Raises:
            DexFlexError: If a name is unknown, an essential one is missing, or a value does not fit.
        """
        definition = values.get("draft_definition", DRAFT_DEFINITION)
        if definition != DRAFT_DEFINITION:
            raise DexFlexError(
                f"{source} is of a controller whose drafts are {definition!r}; here they are "
                f"{DRAFT_DEFINITION!r} (where fingertips should be, minus where they are measured). Train it "
                "anew with `dexflex-corpus` and `dexflex-train`, or use the shipped controller."
            )
        if "format" in values:
            _check_identity("format", values["format"])
        known = {item.name for item in fields(cls)}
        missing, unknown = sorted({*_IDENTITY, "hand"} - set(values)), sorted(set(values) - known)
        if missing or unknown:
            raise DexFlexError(
                f"{source} is not a controller's: missing {missing}, unknown {unknown}. "
                "A controller's folder is written by `DexFlexController.save_pretrained`."
            )
        return cls(**values)

    @classmethod
    def load(cls, path: Path) -> "ControllerConfig":
        """Read `config.json`.

        Raises:
            DexFlexError: If the file is no controller's configuration.
        """
        try:
            values = json.loads(path.read_text())
        except (json.JSONDecodeError, UnicodeDecodeError) as error:
            raise DexFlexError(
                f"{path} is not valid JSON ({error}). Download the controller again."
            ) from error
        if not isinstance(values, dict):
            raise DexFlexError(f"{path} must hold a JSON object. Download the controller again.")
        values.pop(CHECKSUMS, None)
        return cls.from_dict(values, str(path))

    def save(self, path: Path) -> None:
        """Write `config.json`."""
        path.write_text(json.dumps(asdict(self), indent=2) + "\n")


def _check_identity(name: str, value: Any) -> None:
    """Refuse what the code does not serve."""
    served = _IDENTITY[name]
    if value != served:
        raise DexFlexError(
            f"A controller with `{name}` {value!r} cannot run here: this code serves {served!r}. "
            "Use a controller trained for it, or the lerobot_dexflex that trained this one."
        )


def _check_value(name: str, kind: Any, value: Any) -> None:
    """Refuse what is of another type than its field, or a number that is not positive."""
    if kind is bool or kind is str:
        fits, valid = isinstance(value, kind), f"a {kind.__name__}"
    elif kind is float:
        fits = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
        valid = "a positive number"
    elif kind is int:
        fits, valid = type(value) is int and value > 0, "a positive whole number"
    else:
        fits, valid = isinstance(value, tuple) and len(value) > 0, "a list"
    if not fits:
        raise DexFlexError(
            f"`{name}` of a controller must be {valid}. Got {value!r}; its config.json was changed or "
            "damaged: download or train the controller again."
        )
