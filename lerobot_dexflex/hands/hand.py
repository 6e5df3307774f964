"""Describe a hand by numbers: everything that model, kinematics, touch and grasps need to know of it."""

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands.body import PALM, Box, Inertia, Link, Motor, Quaternion, Shape, Vector3
from lerobot_dexflex.hands.finger import Finger
from lerobot_dexflex.hands.tables import Tables, rotation_of, tables_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hand:
    """A hand of any number of fingers, each of any number of joints.

    Joints are counted finger by finger in the order of `fingers`, from the palm outward. Every array over
    fingers or joints has that order.

    Raises:
        DexFlexError: If lengths, limits, names or sizes do not fit together.
    """

    name: str
    """How commands and configurations call the hand, as "leap"."""
    fingers: tuple[Finger, ...]
    """The fingers; their order is that of all arrays."""
    opposing: tuple[str, ...]
    """Names of the fingers that press against the others, as the thumb."""
    palm_inertia: Inertia
    """Mass properties of the palm in its frame."""
    palm_collision: tuple[Shape, ...]
    """Shapes of the palm in its frame [m]."""
    mount_position: Vector3
    """Palm origin in the frame of the arm's flange [m]."""
    mount_quaternion: Quaternion
    """Orientation of the palm in the frame of the arm's flange (w x y z)."""
    relaxed_joints: tuple[float, ...]
    """Fingers at rest, stretched forward [rad]. Shape (joints,)."""
    nominal_joints: tuple[float, ...]
    """A half-closed hand whose pads face each other [rad]. Shape (joints,)."""
    idle_joints: tuple[float, ...]
    """Fingers that keep out of the way of a grasp they take no part in [rad]. Shape (joints,)."""
    taxels: tuple[int, int]
    """Taxels of a fingertip along the finger (the last row is nearest the tip) and across it."""
    taxel_pitch: tuple[float, float]
    """Spacing of the taxels along the finger and across it [m]."""
    palmar: Box
    """Part of the fingertip whose contact forces the taxels carry, in the pad frame [m]."""
    object_region: tuple[Vector3, Vector3]
    """Lower and upper corner of the box that centres of graspable objects lie in, palm frame [m]."""
    pad_spacing: float
    """Smallest distance between the pads of two fingers in a grasp [m], a little more than a pad is wide."""
    finger_order: Vector3
    """Unit vector across the palm from the last toward the first of the fingers that do not oppose."""
    excluded: tuple[tuple[str, str], ...] = ()
    """Pairs of links that never collide with each other, because their shapes overlap at a joint."""
    open_joints: tuple[float, ...] = ()
    """A person's flat, open hand: fingers straight, the thumb spread [rad]. Shape (joints,); none means zero
    angles, or the limits nearest to it."""
    loose_joints: tuple[float, ...] = ()
    """A loosely bent hand, which fingers prefer where a person leaves them free [rad]. Shape (joints,); none
    means `nominal_joints`."""

    def __post_init__(self) -> None:
        if len(self.fingers) < 2:
            raise DexFlexError(f"Hand '{self.name}' needs two fingers or more. Got {len(self.fingers)}.")
        straight = tuple(float(np.clip(0.0, *link.joint_range)) for link in self.links)
        object.__setattr__(self, "open_joints", self.open_joints or straight)
        object.__setattr__(self, "loose_joints", self.loose_joints or self.nominal_joints)
        self._check_names()
        self._check_postures()
        self._check_sizes()

    def _check_names(self) -> None:
        _check_unique("finger", self.finger_names)
        _check_unique("prefix", self.prefixes)
        _check_unique("link", (PALM, *self.link_names))
        _check_unique("joint", self.joint_names)
        for name in self.opposing:
            _check_known("`opposing`", name, self.finger_names)
        if not 0 < len(set(self.opposing)) < self.n_fingers:
            raise DexFlexError(
                f"`opposing` must name some of the fingers {list(self.finger_names)}, not none and not all. "
                f"Got {list(self.opposing)}."
            )
        for name in (name for pair in self.excluded for name in pair):
            _check_known("`excluded`", name, (PALM, *self.link_names))

    def _check_postures(self) -> None:
        for field in ("relaxed_joints", "nominal_joints", "idle_joints", "open_joints", "loose_joints"):
            posture = getattr(self, field)
            if len(posture) != self.n_joints:
                raise DexFlexError(
                    f"`{field}` must hold {self.n_joints} angles [rad], one per joint in the order "
                    f"{list(self.joint_names)}. Got {len(posture)}."
                )
            for link, angle in zip(self.links, posture, strict=True):
                if not link.joint_range[0] <= angle <= link.joint_range[1]:
                    raise DexFlexError(
                        f"`{field}` puts joint '{link.joint}' at {angle} rad, outside its limits "
                        f"{link.joint_range}. Choose an angle within them."
                    )

    def _check_sizes(self) -> None:
        for field in ("taxels", "taxel_pitch"):
            pair = getattr(self, field)
            if len(pair) != 2 or not min(pair) > 0:
                raise DexFlexError(f"`{field}` must be two positive numbers, along and across. Got {pair}.")
        if not all(low < high for low, high in zip(*self.object_region, strict=True)):
            raise DexFlexError(
                "`object_region` must be a lower and an upper corner [m], lower < upper along x, y and z. "
                f"Got {self.object_region}."
            )
        if not abs(math.hypot(*self.finger_order) - 1) < 1e-6:
            raise DexFlexError(f"`finger_order` must be a unit vector. Got {self.finger_order}.")
        if not self.pad_spacing > 0:
            raise DexFlexError(f"`pad_spacing` must be positive [m]. Got {self.pad_spacing}.")
        if not self.palm_inertia.mass > 0:
            raise DexFlexError(f"The mass of the palm must be positive [kg]. Got {self.palm_inertia.mass}.")

    @cached_property
    def signature(self) -> str:
        """Name and a digest of all numbers, for what must not be continued with another hand of the name."""
        return f"{self.name}-{hashlib.sha256(repr(self).encode()).hexdigest()[:8]}"

    @cached_property
    def n_fingers(self) -> int:
        """Number of fingers."""
        return len(self.fingers)

    @cached_property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.links)

    @cached_property
    def finger_names(self) -> tuple[str, ...]:
        """What people call the fingers."""
        return tuple(finger.name for finger in self.fingers)

    @cached_property
    def prefixes(self) -> tuple[str, ...]:
        """What the names of the fingers' sites and sensors begin with."""
        return tuple(finger.prefix for finger in self.fingers)

    @cached_property
    def links(self) -> tuple[Link, ...]:
        """Links of all fingers; each moves with the joint of the same place."""
        return tuple(link for finger in self.fingers for link in finger.links)

    @cached_property
    def motors(self) -> tuple[Motor, ...]:
        """Motors of all joints."""
        return tuple(motor for finger in self.fingers for motor in finger.motors)

    @cached_property
    def link_names(self) -> tuple[str, ...]:
        """Names of all links but the palm."""
        return tuple(link.name for link in self.links)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints."""
        return tuple(link.joint for link in self.links)

    @cached_property
    def distal_links(self) -> tuple[str, ...]:
        """Name of the link that carries each finger's tip."""
        return tuple(finger.distal for finger in self.fingers)

    @cached_property
    def finger_joints(self) -> tuple[slice, ...]:
        """Where each finger's joints stand in arrays over joints."""
        starts = np.cumsum([0, *[len(finger.links) for finger in self.fingers]]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(starts))

    @cached_property
    def finger_of_joint(self) -> NDArray[np.int64]:
        """Index of the finger that each joint belongs to. Shape (joints,)."""
        return _fixed(np.repeat(np.arange(self.n_fingers), [len(finger.links) for finger in self.fingers]))

    @cached_property
    def opposing_fingers(self) -> tuple[int, ...]:
        """Indices of the fingers that press against the others."""
        return tuple(k for k, name in enumerate(self.finger_names) if name in self.opposing)

    @cached_property
    def opposed_fingers(self) -> tuple[int, ...]:
        """Indices of the fingers that the opposing ones press against."""
        return tuple(k for k in range(self.n_fingers) if k not in self.opposing_fingers)

    @cached_property
    def pad_rotations(self) -> Array:
        """Orientation of each pad in its distal link: along, across, outward. Shape (fingers, 3, 3)."""
        return _fixed(np.array([rotation_of(finger.pad_quaternion) for finger in self.fingers]))

    @cached_property
    def joint_lower(self) -> Array:
        """Lower joint limits [rad]. Shape (joints,)."""
        return _fixed(self.tables.lower.copy())

    @cached_property
    def joint_upper(self) -> Array:
        """Upper joint limits [rad]. Shape (joints,)."""
        return _fixed(self.tables.upper.copy())

    @cached_property
    def position_gains(self) -> Array:
        """Position gain of each motor [N m/rad]. Shape (joints,)."""
        return _fixed(np.array([motor.position_gain for motor in self.motors]))

    @cached_property
    def grip_torques(self) -> Array:
        """Largest torque with which a grip loads each joint [N m]. Shape (joints,)."""
        return _fixed(np.array([motor.grip_torque for motor in self.motors]))

    @cached_property
    def joint_speeds(self) -> Array:
        """Largest speed of each joint [rad/s]. Shape (joints,)."""
        return _fixed(np.array([motor.speed for motor in self.motors]))

    @cached_property
    def tables(self) -> Tables:
        """The hand's numbers as the compiled kinematics of `hand.kernels` read them."""
        return tables_of(self.fingers)


def _fixed[T: NDArray](array: T) -> T:
    """Make an array read-only: it is shared by all who ask for it."""
    array.flags.writeable = False
    return array


def _check_unique(what: str, names: Iterable[str]) -> None:
    seen = set()
    for name in names:
        if not name or name in seen:
            raise DexFlexError(
                f"Every {what} of a hand needs a name of its own. Got '{name}' again or empty."
            )
        seen.add(name)


def _check_known(field: str, name: str, valid: Iterable[str]) -> None:
    if name not in valid:
        raise DexFlexError(
            f"{field} names '{name}', which the hand does not have. Choose from {list(valid)}."
        )
