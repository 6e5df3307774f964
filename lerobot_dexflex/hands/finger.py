"""Describe one finger of a hand by numbers, and refuse numbers that make no finger."""

import math
from dataclasses import dataclass

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands.body import PALM, Link, Motor, Quaternion, Shape, Vector3

_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Finger:
    """A chain of links from the palm to a fingertip that can feel.

    Raises:
        DexFlexError: If lengths, limits, axes, motors or names do not fit together.
    """

    name: str
    """What people call the finger, as "index"; unique within the hand."""
    prefix: str
    """Begins the names of the finger's sites and sensors in the model, as "if"; unique within the hand."""
    links: tuple[Link, ...]
    """Links from the palm outward: the first hangs on the body `PALM`, every other on the one before it."""
    motors: tuple[Motor, ...]
    """Motor of each link's joint, in the order of `links`."""
    collision: tuple[tuple[Shape, ...], ...]
    """Shapes of each link in its frame [m], in the order of `links`; the fingertip is not among them."""
    tip: Shape
    """Shape behind the pad in the distal frame [m]; the distal link is the last of `links`."""
    tip_position: Vector3
    """Fingertip point in the distal frame [m]."""
    pad_position: Vector3
    """Centre of the contact face in the distal frame [m]."""
    pad_quaternion: Quaternion
    """Pad frame in the distal frame (w x y z): z outward, x toward the tip, y across the finger."""
    pad_half_size: tuple[float, float]
    """Half extent of the contact face along the finger and across it [m]."""
    nose: Shape | None = None
    """Rounded end of the fingertip in the distal frame [m], where the shape behind the pad has none."""

    def __post_init__(self) -> None:
        if not self.links:
            raise DexFlexError(f"Finger '{self.name}' has no links. Give it at least one in `links`.")
        for field in ("motors", "collision"):
            count = len(getattr(self, field))
            if count != len(self.links):
                raise DexFlexError(
                    f"Finger '{self.name}' has {len(self.links)} links but {count} entries in `{field}`. "
                    "Give one per link, in the order of `links`."
                )
        if not min(self.pad_half_size) > 0:
            raise DexFlexError(
                f"`pad_half_size` of finger '{self.name}' must be positive [m]. Got {self.pad_half_size}."
            )
        _check_quaternion(f"`pad_quaternion` of finger '{self.name}'", self.pad_quaternion)
        parent = PALM
        for link, motor in zip(self.links, self.motors, strict=True):
            if link.parent != parent:
                raise DexFlexError(
                    f"Link '{link.name}' of finger '{self.name}' must hang on '{parent}'. Got "
                    f"'{link.parent}'. List `links` from the palm outward, each on the one before it."
                )
            _check_link(link)
            _check_motor(link.joint, motor)
            parent = link.name

    @property
    def distal(self) -> str:
        """Name of the body that carries the fingertip."""
        return self.links[-1].name


def _check_link(link: Link) -> None:
    lower, upper = link.joint_range
    if not lower < upper:
        raise DexFlexError(
            f"Limits of joint '{link.joint}' must be (lower, upper) [rad] with lower < upper. "
            f"Got {link.joint_range}. Swap or correct them."
        )
    if not abs(math.hypot(*link.axis) - 1) < _UNIT_TOLERANCE:
        raise DexFlexError(
            f"The axis of joint '{link.joint}' must be a unit vector. Got {link.axis} of length "
            f"{math.hypot(*link.axis):.6g}. Divide it by its length."
        )
    _check_quaternion(f"The quaternion of link '{link.name}'", link.quaternion)
    if not link.inertia.mass > 0:
        raise DexFlexError(f"The mass of link '{link.name}' must be positive [kg]. Got {link.inertia.mass}.")


def _check_quaternion(what: str, quaternion: Quaternion) -> None:
    if not 0 < math.hypot(*quaternion) < math.inf:
        raise DexFlexError(f"{what} must be four numbers (w x y z), not all zero. Got {quaternion}.")


def _check_motor(joint: str, motor: Motor) -> None:
    for field in ("position_gain", "torque", "speed"):
        if not getattr(motor, field) > 0:
            raise DexFlexError(
                f"`{field}` of the motor of joint '{joint}' must be positive. Got {getattr(motor, field)}."
            )
    for field in ("velocity_gain", "armature", "damping", "friction_loss"):
        if not getattr(motor, field) >= 0:
            raise DexFlexError(
                f"`{field}` of the motor of joint '{joint}' must not be negative. "
                f"Got {getattr(motor, field)}."
            )
    if not 0 < motor.grip_torque <= motor.torque:
        raise DexFlexError(
            f"`grip_torque` of the motor of joint '{joint}' must be positive and at most its `torque`, "
            f"{motor.torque} N m. Got {motor.grip_torque}."
        )
