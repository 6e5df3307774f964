"""A third hand, like the Allegro hand v4 (right): three fingers and a thumb of four joints each.

Kinematics, limits and shapes: the numbers of Wonik's public URDF, as MuJoCo Menagerie `wonik_allegro` has
them. Approximate are: masses (the URDF's, rounded), inertias (of solid boxes), the largest torque (0.7 N m),
gains and rotors (chosen like LEAP's), and touch, which the real hand lacks: flat pads on the palmar side of
the round tips.
"""

import math

from lerobot_dexflex.hands import PALM, Finger, Hand
from lerobot_dexflex.hands.body import Box, Inertia, Link, Motor, Quaternion, Rod, Shape, Vector3

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_THUMB_AXIS = (-1.0, 0.0, 0.0)
_AHEAD: Quaternion = (1, 0, 0, 0)
_PALMAR: Quaternion = (0, 1, 0, 1)
"""The pad looks along +x of the distal link, its tip lies along +z."""
_MOTOR = Motor(
    position_gain=3.0,
    velocity_gain=0.01,
    torque=0.7,
    grip_torque=0.6,
    speed=9.5,
    armature=0.0015,
    damping=0.03,
    friction_loss=0.001,
)


def _solid(mass: float, half_size: Vector3, centre: Vector3) -> Inertia:
    x, y, z = (size**2 for size in half_size)
    return Inertia(mass, centre, _AHEAD, (mass / 3 * (y + z), mass / 3 * (x + z), mass / 3 * (x + y)))


def _block(half_length: float) -> Box:
    return Box((0.0098, 0.01375, half_length), (0.0, 0.0, half_length))


def _link(
    name: str,
    parent: str,
    place: tuple[Vector3, Quaternion],
    mass: float,
    shape: Box,
    joint_range: tuple[float, float],
    axis: Vector3,
) -> Link:
    inertia = _solid(mass, shape.half_size, shape.position)
    return Link(name, parent, *place, inertia, f"{name}_joint", joint_range, axis)


def _finger(name: str, prefix: str, links: tuple[Link, ...], shapes: tuple[Box, ...], tip: Rod) -> Finger:
    """Return a finger that ends in an upright capsule; the pad is its palmar side."""
    height = tip.position[2]
    collision: tuple[tuple[Shape, ...], ...] = tuple((shape,) for shape in shapes)
    return Finger(
        name=name,
        prefix=prefix,
        links=links,
        motors=(_MOTOR,) * len(links),
        collision=collision,
        tip=tip,
        tip_position=(0.0, 0.0, height + tip.half_length + tip.radius - 0.001),
        pad_position=(tip.radius, 0.0, height + 0.003),
        pad_quaternion=_PALMAR,
        pad_half_size=(0.0105, 0.0085),
    )


_SHAPES = (_block(0.0082), _block(0.027), _block(0.0192), _block(0.008))


def _long_finger(name: str, prefix: str, knuckle: Vector3, mounted: Quaternion) -> Finger:
    base, proximal, medial, distal = (f"{prefix}_{part}" for part in ("base", "proximal", "medial", "distal"))
    links = (
        _link(base, PALM, (knuckle, mounted), 0.012, _SHAPES[0], (-0.47, 0.47), _Z),
        _link(proximal, base, ((0.0, 0.0, 0.0164), _AHEAD), 0.065, _SHAPES[1], (-0.196, 1.61), _Y),
        _link(medial, proximal, ((0.0, 0.0, 0.054), _AHEAD), 0.036, _SHAPES[2], (-0.174, 1.709), _Y),
        _link(distal, medial, ((0.0, 0.0, 0.0384), _AHEAD), 0.026, _SHAPES[3], (-0.227, 1.618), _Y),
    )
    return _finger(name, prefix, links, _SHAPES, Rod(0.012, 0.01, (0.0, 0.0, 0.019)))


def _thumb() -> Finger:
    shapes = (
        Box((0.0179, 0.017, 0.02275), (-0.0179, 0.009, 0.0145)),
        _block(0.00885),
        _block(0.0257),
        _block(0.0157),
    )
    mounted = ((-0.0182, 0.019333, -0.045987), (0.477714, -0.521334, -0.521334, -0.477714))
    links = (
        _link("th_base", PALM, mounted, 0.018, shapes[0], (0.263, 1.396), _THUMB_AXIS),
        _link(
            "th_proximal", "th_base", ((-0.027, 0.005, 0.0399), _AHEAD), 0.012, shapes[1], (-0.105, 1.163), _Z
        ),
        _link(
            "th_medial", "th_proximal", ((0.0, 0.0, 0.0177), _AHEAD), 0.038, shapes[2], (-0.189, 1.644), _Y
        ),
        _link("th_distal", "th_medial", ((0.0, 0.0, 0.0514), _AHEAD), 0.055, shapes[3], (-0.162, 1.719), _Y),
    )
    return _finger("thumb", "th", links, shapes, Rod(0.012, 0.008, (0.0, 0.0, 0.035)))


_SPLAY = math.radians(5) / 2
_FINGERS = (
    _long_finger("index", "ff", (0.0, 0.0435, -0.001542), (math.cos(_SPLAY), -math.sin(_SPLAY), 0, 0)),
    _long_finger("middle", "mf", (0.0, 0.0, 0.0007), _AHEAD),
    _long_finger("ring", "rf", (0.0, -0.0435, -0.001542), (math.cos(_SPLAY), math.sin(_SPLAY), 0, 0)),
    _thumb(),
)
_PALM_SHAPE = Box((0.0204, 0.0565, 0.0475), (-0.0093, 0.0, -0.0475))

ALLEGRO = Hand(
    name="allegro",
    fingers=_FINGERS,
    opposing=("thumb",),
    palm_inertia=_solid(0.415, _PALM_SHAPE.half_size, _PALM_SHAPE.position),
    palm_collision=(_PALM_SHAPE,),
    # The palm continues the flange's axis.
    mount_position=(0.0, 0.0, 0.11),
    mount_quaternion=_AHEAD,
    relaxed_joints=(0.0, 0.4, 0.4, 0.3) * 3 + (0.9, 0.3, 0.2, 0.2),
    nominal_joints=(0.0, 1.14, 0.36, 0.16) * 3 + (1.31, 0.37, 0.41, 0.14),
    idle_joints=(0.0, 0.1, 0.2, 0.2) * 3 + (0.5, 0.1, 0.1, 0.1),
    taxels=(10, 6),
    taxel_pitch=(0.002, 0.0027),
    palmar=Box((0.016, 0.012, 0.008), (0.002, 0.0, -0.005)),
    object_region=((0.075, -0.02, -0.025), (0.12, 0.04, 0.03)),
    pad_spacing=0.022,
    finger_order=_Y,
)
"""Allegro-like right hand: index, middle and ring finger against the thumb."""
