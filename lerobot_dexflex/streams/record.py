"""One tick of an operator's hand, whatever device saw it."""

from dataclasses import dataclass, fields
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import Hand

Array = NDArray[np.float64]
Side = Literal["right", "left"]
"""Which hand of the operator's."""

_FINGERS = ("index_finger", "middle_finger", "ring_finger", "pinky")
KEYPOINT_NAMES = (
    "wrist",
    *(f"thumb_{joint}" for joint in ("cmc", "mcp", "ip", "tip")),
    *(f"{finger}_{joint}" for finger in _FINGERS for joint in ("mcp", "pip", "dip", "tip")),
)
"""MediaPipe's landmarks, 0 to 20: every other format is brought into this order."""
KEYPOINTS = len(KEYPOINT_NAMES)
HUMAN_TIPS = {"thumb": 4, "index": 8, "middle": 12, "ring": 16, "pinky": 20}
"""Keypoints that are fingertips."""

MAX_REACH = 0.4
"""No keypoint is farther from the wrist [m]. A hand is half as long: this tells metres from other units."""


@dataclass(frozen=True, eq=False)
class Record:
    """What is known of an operator's hand at one time. Arrays are read-only; what is untracked is NaN.

    The world is right-handed, x forward, y left, z up; its origin is the device's. The wrist frame is that of
    `wrist_frame`: x toward the middle finger, y toward the index of a right hand, z out of the back.

    Raises:
        DexFlexError: If a shape is wrong, or a value that counts as tracked cannot be right.
    """

    t: float
    """The sender's clock [s]; only differences mean something."""
    wrist_position: Array
    """In the world [m]. Shape (3,)."""
    wrist_rotation: Array
    """Axes of the wrist frame in the world, as columns. Shape (3, 3)."""
    keypoints: Array
    """In the wrist frame, as `KEYPOINT_NAMES` [m]. Shape (21, 3)."""
    tracked: NDArray[np.bool_]
    """Whether each keypoint is. Shape (21,)."""
    wrist_tracked: bool
    """Whether the pose of the wrist is; keypoints may be without it."""

    @classmethod
    def lost(cls, t: float) -> Self:
        """Return the record of a hand that the device does not see."""
        unknown = np.full((KEYPOINTS, 3), np.nan)
        return cls(t, unknown[0], unknown[:3], unknown, np.zeros(KEYPOINTS, bool), False)

    @property
    def is_lost(self) -> bool:
        """Whether no keypoint is tracked."""
        return not self.tracked.any()

    def __post_init__(self) -> None:
        for field, shape in zip(
            fields(self), ((), (3,), (3, 3), (KEYPOINTS, 3), (KEYPOINTS,), ()), strict=True
        ):
            kind = bool if field.name.endswith("tracked") else float
            self._put(field.name, _checked(field.name, getattr(self, field.name), shape, kind))
        if not np.isfinite(self.t):
            raise DexFlexError(f"`t` must be a finite time in seconds. Got {self.t}.")
        self._check_keypoints()
        self._check_wrist()

    def _check_keypoints(self) -> None:
        keypoints = np.where(self.tracked[:, None], self.keypoints, np.nan)
        if broken := _names(self.tracked & ~np.isfinite(keypoints).all(1)):
            raise DexFlexError(f"`keypoints` must be finite where `tracked`: {broken} are not. Untrack them.")
        reach = np.linalg.norm(keypoints[self.tracked], axis=1).max(initial=0.0)
        if reach > MAX_REACH:
            raise DexFlexError(
                f"`keypoints` must be within {MAX_REACH} m of the wrist. Got {reach:.3g}: convert units."
            )
        self._put("keypoints", keypoints)

    def _check_wrist(self) -> None:
        if not self.wrist_tracked:
            self._put("wrist_position", np.full(3, np.nan))
            self._put("wrist_rotation", np.full((3, 3), np.nan))
            return
        if not np.isfinite(self.wrist_position).all():
            place = self.wrist_position.tolist()
            raise DexFlexError(f"`wrist_position` must be finite, or the wrist not tracked. Got {place}.")
        turn = self.wrist_rotation
        if not (np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0):
            raise DexFlexError(
                f"`wrist_rotation` must be a rotation, right-handed and orthonormal. Got {turn.tolist()}."
            )

    def _put(self, name: str, value: Any) -> None:
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        object.__setattr__(self, name, value)


def leading_tips(hand: Hand) -> list[int]:
    """Return which keypoints lead a robot's fingertips, in the order of its fingers: those of the same name.

    Raises:
        DexFlexError: If a person has no finger of that name.
    """
    strangers = [name for name in hand.finger_names if name not in HUMAN_TIPS]
    if strangers:
        raise DexFlexError(
            f"A person has no finger '{strangers[0]}' to lead that of '{hand.name}'. Name the fingers of the "
            f"hand as those that shall lead them: {', '.join(HUMAN_TIPS)}."
        )
    return [HUMAN_TIPS[name] for name in hand.finger_names]


def _checked(name: str, value: Any, shape: tuple[int, ...], kind: type) -> Any:
    """Return a copy of the value in its type; refuse another shape."""
    try:
        array = np.array(value, kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise DexFlexError(f"`{name}` must hold numbers of shape {shape}. {error}.") from error
    if array.shape != shape:
        raise DexFlexError(f"`{name}` must have shape {shape}. Got {array.shape}.")
    return array if shape else array.item()


def _names(chosen: NDArray[np.bool_]) -> str:
    return ", ".join(name for name, one in zip(KEYPOINT_NAMES, chosen, strict=True) if one)
