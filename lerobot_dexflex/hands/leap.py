"""LEAP hand (right, 16 DoF) in numbers (source: MuJoCo Menagerie `leap_hand/right_hand.xml`, MIT).

Motor figures follow MuJoCo Playground's `leap_rh_mjx.xml` (Apache-2.0) where noted. Only numbers are taken
over; the collision boxes are our own approximation of the meshes.
"""

import math

from lerobot_dexflex.hands.body import PALM, Box, Inertia, Link, Motor, Rod, Vector3
from lerobot_dexflex.hands.finger import Finger
from lerobot_dexflex.hands.hand import Hand

_AXIS = (0.0, 0.0, -1.0)
"""Every joint turns about -z of its own link."""
_MOTOR = Motor(
    position_gain=3.0,
    velocity_gain=0.01,
    # The thumb then presses with about 6 N.
    torque=0.6,
    # A little less than the motors have.
    grip_torque=0.55,
    # The servo's, Dynamixel XC330-M288-T at 5 V without load, 81 rev/min (ROBOTIS e-manual).
    speed=81 * 2 * math.pi / 60,
    # 1.7e-8 * 288^2 (MuJoCo Playground).
    armature=0.0015,
    damping=0.03,
    friction_loss=0.001,
)

_PALM_INERTIA = Inertia(
    0.237,
    (-0.049542, -0.042914, -0.010227),
    (0.565586, 0.427629, -0.574956, 0.408254),
    (4.07345e-4, 3.04759e-4, 1.80736e-4),
)
_BASE = Inertia(
    0.044,
    (-0.022516, 0.033882, 0.016359),
    (0.388092, 0.677951, -0.247713, 0.573067),
    (1.74972e-5, 1.61504e-5, 7.21342e-6),
)
_PROXIMAL = Inertia(
    0.032, (0.0075, -0.0002, -0.011), (0.0, 0.707107, 0.0, 0.707107), (4.8853e-6, 4.3733e-6, 3.0933e-6)
)
_MEDIAL = Inertia(
    0.037,
    (0.0054215, -0.029148, 0.015),
    (0.687228, 0.687228, 0.166487, 0.166487),
    (8.28004e-6, 8.1598e-6, 5.39516e-6),
)
_DISTAL = Inertia(
    0.016,
    (-0.0008794, -0.027019, 0.014594),
    (0.702905, 0.710643, -0.0212937, -0.0214203),
    (3.71863e-6, 3.02396e-6, 1.6518e-6),
)
_THUMB_BASE = Inertia(
    0.003, (0.0, 0.0, -0.0070806), (0.707107, 0.707107, 0.0, 0.0), (6.1932e-7, 5.351e-7, 2.1516e-7)
)
_THUMB_PROXIMAL = Inertia(
    0.038,
    (-0.0020593, 0.015912, -0.013733),
    (0.698518, 0.697382, -0.104933, 0.121324),
    (9.87104e-6, 9.32653e-6, 4.36203e-6),
)
_THUMB_DISTAL = Inertia(
    0.049,
    (0.00096191, -0.024203, -0.014419),
    (0.35287, 0.311272, -0.632839, 0.614904),
    (2.08591e-5, 2.0402e-5, 4.71335e-6),
)

_H = 0.5


def _links(name: str, knuckle: Vector3, distal_y: float = -0.0361) -> tuple[Link, ...]:
    return (
        Link(f"{name}_bs", PALM, knuckle, (_H, _H, _H, -_H), _BASE, f"{name}_mcp", (-0.314, 2.23), _AXIS),
        Link(
            f"{name}_px",
            f"{name}_bs",
            (-0.0122, 0.0381, 0.0145),
            (_H, -_H, -_H, _H),
            _PROXIMAL,
            f"{name}_rot",
            (-1.047, 1.047),
            _AXIS,
        ),
        Link(
            f"{name}_md",
            f"{name}_px",
            (0.015, 0.0143, -0.013),
            (_H, _H, -_H, _H),
            _MEDIAL,
            f"{name}_pip",
            (-0.506, 1.885),
            _AXIS,
        ),
        Link(
            f"{name}_ds",
            f"{name}_md",
            (0.0, distal_y, 0.0002),
            (1, 0, 0, 0),
            _DISTAL,
            f"{name}_dip",
            (-0.366, 2.042),
            _AXIS,
        ),
    )


_THUMB_LINKS = (
    Link(
        "th_mp",
        PALM,
        (-0.0693, -0.0012, -0.0216),
        (1, 0, 1, 0),
        _PROXIMAL,
        "th_cmc",
        (-0.349, 2.094),
        _AXIS,
    ),
    Link(
        "th_bs",
        "th_mp",
        (0.0, 0.0143, -0.013),
        (_H, _H, -_H, _H),
        _THUMB_BASE,
        "th_axl",
        (-0.349, 2.094),
        _AXIS,
    ),
    Link(
        "th_px",
        "th_bs",
        (0.0, 0.0145, -0.017),
        (1, -1, 0, 0),
        _THUMB_PROXIMAL,
        "th_mcp",
        (-0.47, 2.443),
        _AXIS,
    ),
    Link(
        "th_ds", "th_px", (0.0, 0.0466, 0.0002), (0, 0, 0, 1), _THUMB_DISTAL, "th_ipl", (-1.34, 1.88), _AXIS
    ),
)

_PALM_COLLISION = (
    Box((0.011, 0.013, 0.017), (-0.009, 0.008, -0.011)),
    Box((0.011, 0.013, 0.017), (-0.009, -0.037, -0.011)),
    Box((0.011, 0.013, 0.017), (-0.009, -0.082, -0.011)),
    Box((0.022, 0.060, 0.019), (-0.042, -0.034, -0.0075)),
    Box((0.022, 0.030, 0.023), (-0.078, -0.053, -0.0115)),
    Box((0.022, 0.028, 0.002), (-0.078, -0.003, 0.010)),
)
_FINGER_COLLISION = (
    (
        Box((0.01, 0.003, 0.017), (0.0, 0.018, 0.0147)),
        Box((0.014, 0.02, 0.014), (-0.027, 0.04, 0.018)),
    ),
    (Box((0.017, 0.013, 0.011), (0.0075, -0.0002, -0.011)),),
    (
        Box((0.008, 0.008, 0.015), (0.0, -0.016, 0.015)),
        Box((0.017, 0.011, 0.013), (0.0075, -0.035, 0.015)),
    ),
    (Box((0.009, 0.008, 0.014), (0.0, -0.012, 0.015)),),
)
_THUMB_COLLISION = (
    (Box((0.017, 0.013, 0.011), (-0.0075, -0.0002, -0.011)),),
    (Box((0.009, 0.0165, 0.002), (0.0, 0.0, -0.0015)),),
    (
        Box((0.01, 0.02, 0.012), (0.0, 0.0105, -0.014)),
        Box((0.007, 0.012, 0.015), (0.0, 0.04, -0.014)),
    ),
    (Box((0.01, 0.018, 0.012), (0.0, -0.0115, -0.015)),),
)

_PAD_HALF_SIZE = (0.013, 0.0105)
_PAD_QUATERNION = (0.5, 0.5, -0.5, -0.5)
"""The pad looks along -x of the distal frame, its tip lies along -y and z goes across."""
_TIP_HALF_THICKNESS = 0.0102
"""Of the block behind the contact face [m]."""


def _finger(
    name: str,
    prefix: str,
    links: tuple[Link, ...],
    collision: tuple[tuple[Box, ...], ...],
    tip: Vector3,
    pad: Vector3,
) -> Finger:
    """Return a finger with a flat pad block, rounded at its end; tips are MuJoCo Playground's sites."""
    x, y, z = pad
    along, across = _PAD_HALF_SIZE
    return Finger(
        name=name,
        prefix=prefix,
        links=links,
        motors=(_MOTOR,) * len(links),
        collision=collision,
        tip=Box((_TIP_HALF_THICKNESS, along - 0.001, across), (x + _TIP_HALF_THICKNESS, y + 0.001, z)),
        nose=Rod(0.0085, 0.004, (x + _TIP_HALF_THICKNESS, y - 0.0085, z)),
        tip_position=tip,
        pad_position=pad,
        pad_quaternion=_PAD_QUATERNION,
        pad_half_size=_PAD_HALF_SIZE,
    )


_FINGERS = tuple(
    _finger(name, prefix, links, _FINGER_COLLISION, (0.0, -0.05, 0.015), (-0.0112, -0.034, 0.0145))
    for name, prefix, links in (
        ("index", "if", _links("if", (-0.007, 0.023, -0.0187))),
        ("middle", "mf", _links("mf", (-0.0071, -0.0224, -0.0187))),
        ("ring", "rf", _links("rf", (-0.00709, -0.0678, -0.0187), -0.03609)),
    )
)
_THUMB = _finger(
    "thumb", "th", _THUMB_LINKS, _THUMB_COLLISION, (0.0, -0.06, -0.015), (-0.0112, -0.046, -0.0145)
)

LEAP = Hand(
    name="leap",
    fingers=(*_FINGERS, _THUMB),
    opposing=("thumb",),
    palm_inertia=_PALM_INERTIA,
    palm_collision=_PALM_COLLISION,
    mount_position=(0.065, -0.04, 0.0),
    mount_quaternion=(0, 1, 0, 0),
    relaxed_joints=(0.7, 0.0, 0.37, -0.3) * 3 + (1.2, 0.0, 0.39, -0.38),
    nominal_joints=(1.1, 0.0, 0.5, 0.2) * 3 + (1.6, 0.2, 0.8, -0.2),
    idle_joints=(0.4, 0.0, 0.3, 0.2) * 4,
    # FlexiTac's fingertip array: 25 x 20 mm, the flat face of the tip.
    taxels=(10, 6),
    taxel_pitch=(0.0025, 0.0033),
    # The pad and the palmar side of the rounded nose.
    palmar=Box((0.018, 0.014, 0.0066), (0.004, 0.0, -0.0036)),
    object_region=((-0.055, -0.06, -0.145), (0.01, 0.005, -0.085)),
    pad_spacing=0.025,
    finger_order=(0.0, 1.0, 0.0),
    excluded=(
        *((f"{prefix}_ds", f"{prefix}_{link}") for prefix in ("if", "mf", "rf") for link in ("px", "bs")),
        ("th_ds", "th_bs"),
        ("th_ds", "th_mp"),
    ),
    # The thumb as far forward as a person's: an average open hand fits to 8 mm, with a straight one to 20 mm.
    open_joints=(*(0.0,) * 14, 1.0, 0.0),
    loose_joints=(0.4, 0.0, 0.6, 0.4) * 3 + (0.3, 0.0, 0.8, 0.3),
)
"""Right LEAP hand: index, middle and ring finger against the thumb, four joints each."""
