"""Describe rigid links and joints as plain numbers, independent of any simulator."""

from typing import NamedTuple

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


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
    """

    name: str
    parent: str
    position: Vector3
    quaternion: Quaternion
    inertia: Inertia
    joint: str
    joint_range: tuple[float, float]
