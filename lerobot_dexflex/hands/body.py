"""Describe rigid links, joints and motors as plain numbers, independent of any simulator."""

from typing import NamedTuple

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

PALM = "palm"
"""Name of the body that carries the fingers of every hand; its frame is the palm frame."""


class Inertia(NamedTuple):
    """Mass [kg], centre of mass [m], principal frame (w x y z) and principal moments [kg m^2] of a link."""

    mass: float
    position: Vector3
    quaternion: Quaternion
    diagonal: Vector3


class Box(NamedTuple):
    """A collision box: half sizes [m] and centre [m] in the link frame."""

    half_size: Vector3
    position: Vector3


class Capsule(NamedTuple):
    """A collision capsule: end points [m] in the link frame and radius [m]."""

    start: Vector3
    end: Vector3
    radius: float


class Rod(NamedTuple):
    """A collision capsule by its middle: radius and half length [m], centre [m] and frame in the link frame.

    It lies along z of the frame `quaternion` (w x y z), which need not be normalised.
    """

    radius: float
    half_length: float
    position: Vector3
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)


Shape = Box | Rod
"""What the links of a hand collide with."""


class Motor(NamedTuple):
    """The position servo of one joint and the mechanics that it moves."""

    position_gain: float
    """Torque per error of the joint [N m/rad]."""
    velocity_gain: float
    """Torque against the joint's speed [N m s/rad]."""
    torque: float
    """Largest torque [N m]."""
    grip_torque: float
    """Largest torque with which a grip loads the joint [N m]; no more than `torque`."""
    speed: float
    """Largest speed of the joint [rad/s]."""
    armature: float
    """Reflected inertia of the rotor [kg m^2]."""
    damping: float
    """Viscous friction of the joint [N m s/rad]."""
    friction_loss: float
    """Dry friction of the joint [N m]."""


class Link(NamedTuple):
    """One link and the hinge that moves it, about an axis through the link's origin.

    Attributes:
        name: Body name.
        parent: Name of the parent body.
        position: Origin in the parent frame [m].
        quaternion: Orientation in the parent frame (w x y z), not necessarily normalised.
        inertia: Mass properties in the link frame.
        joint: Joint name.
        joint_range: Lower and upper limit [rad].
        axis: Unit vector that the joint turns about, in the link frame.
    """

    name: str
    parent: str
    position: Vector3
    quaternion: Quaternion
    inertia: Inertia
    joint: str
    joint_range: tuple[float, float]
    axis: Vector3
