"""LEAP hand (right, 16 DoF) in numbers (source: MuJoCo Menagerie `leap_hand/right_hand.xml`, MIT).

Motor figures follow MuJoCo Playground's `leap_rh_mjx.xml` (Apache-2.0) where noted. Only numbers are taken
over; the collision boxes are our own approximation of the meshes.
"""

import math

from lerobot_dexflex.hand.body import Box, Inertia, Link, Vector3
from lerobot_dexflex.hand.body import Quaternion as Quaternion

FINGERS = ("if", "mf", "rf", "th")
"""Index, middle, ring, thumb: the order of every per-finger array."""

JOINT_AXIS = (0.0, 0.0, -1.0)
KP = 3.0
"""Position gain [N m/rad]."""
KV = 0.01
"""Velocity gain [N m s/rad]."""
DAMPING = 0.03
"""Joint damping [N m s/rad]."""
FRICTION_LOSS = 0.001
"""Joint dry friction [N m]."""
ARMATURE = 0.0015
"""Reflected rotor inertia [kg m^2]: 1.7e-8 * 288^2 (MuJoCo Playground)."""
TORQUE = 0.6
"""Torque limit [N m]; the thumb then presses with about 6 N."""
GRIP_TORQUE = 0.55
"""Largest torque with which a grip loads a joint [N m], a little less than the motors have."""
MAX_SPEED = 81 * 2 * math.pi / 60
"""Largest speed of a joint [rad/s]: the servo's, Dynamixel XC330-M288-T at 5 V without load, 81 rev/min
(ROBOTIS e-manual)."""

PALM_INERTIA = Inertia(
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


def _finger(name: str, knuckle: Vector3, distal_y: float = -0.0361) -> tuple[Link, ...]:
    return (
        Link(f"{name}_bs", "palm", knuckle, (_H, _H, _H, -_H), _BASE, f"{name}_mcp", (-0.314, 2.23)),
        Link(
            f"{name}_px",
            f"{name}_bs",
            (-0.0122, 0.0381, 0.0145),
            (_H, -_H, -_H, _H),
            _PROXIMAL,
            f"{name}_rot",
            (-1.047, 1.047),
        ),
        Link(
            f"{name}_md",
            f"{name}_px",
            (0.015, 0.0143, -0.013),
            (_H, _H, -_H, _H),
            _MEDIAL,
            f"{name}_pip",
            (-0.506, 1.885),
        ),
        Link(
            f"{name}_ds",
            f"{name}_md",
            (0.0, distal_y, 0.0002),
            (1, 0, 0, 0),
            _DISTAL,
            f"{name}_dip",
            (-0.366, 2.042),
        ),
    )


_THUMB = (
    Link("th_mp", "palm", (-0.0693, -0.0012, -0.0216), (1, 0, 1, 0), _PROXIMAL, "th_cmc", (-0.349, 2.094)),
    Link("th_bs", "th_mp", (0.0, 0.0143, -0.013), (_H, _H, -_H, _H), _THUMB_BASE, "th_axl", (-0.349, 2.094)),
    Link("th_px", "th_bs", (0.0, 0.0145, -0.017), (1, -1, 0, 0), _THUMB_PROXIMAL, "th_mcp", (-0.47, 2.443)),
    Link("th_ds", "th_px", (0.0, 0.0466, 0.0002), (0, 0, 0, 1), _THUMB_DISTAL, "th_ipl", (-1.34, 1.88)),
)

LINKS = (
    *_finger("if", (-0.007, 0.023, -0.0187)),
    *_finger("mf", (-0.0071, -0.0224, -0.0187)),
    *_finger("rf", (-0.00709, -0.0678, -0.0187), -0.03609),
    *_THUMB,
)
"""Sixteen links, four per finger, in `FINGERS` order."""

TIP_POSITION = {f: (0.0, -0.06, -0.015) if f == "th" else (0.0, -0.05, 0.015) for f in FINGERS}
"""Fingertip point in the distal frame `*_ds` [m] (MuJoCo Playground's tip site)."""
PAD_POSITION = {f: (-0.0112, -0.046, -0.0145) if f == "th" else (-0.0112, -0.034, 0.0145) for f in FINGERS}
"""Centre of the flat contact face in the distal frame [m]; its outward normal is -x."""
PAD_HALF_SIZE = (0.013, 0.0105)
"""Half extent of the contact face along the finger (y) and across it (z) [m]."""
PAD_QUATERNION = (0.5, 0.5, -0.5, -0.5)
"""Pad frame in the distal frame: z outward (-x), x toward the tip (-y), y across (+z)."""
TIP_THICKNESS = 0.0102
"""Half thickness of the pad block behind the contact face [m]."""

PALM_COLLISION = (
    Box((0.011, 0.013, 0.017), (-0.009, 0.008, -0.011)),
    Box((0.011, 0.013, 0.017), (-0.009, -0.037, -0.011)),
    Box((0.011, 0.013, 0.017), (-0.009, -0.082, -0.011)),
    Box((0.022, 0.060, 0.019), (-0.042, -0.034, -0.0075)),
    Box((0.022, 0.030, 0.023), (-0.078, -0.053, -0.0115)),
    Box((0.022, 0.028, 0.002), (-0.078, -0.003, 0.010)),
)
_FINGER_COLLISION = {
    "bs": (
        Box((0.01, 0.003, 0.017), (0.0, 0.018, 0.0147)),
        Box((0.014, 0.02, 0.014), (-0.027, 0.04, 0.018)),
    ),
    "px": (Box((0.017, 0.013, 0.011), (0.0075, -0.0002, -0.011)),),
    "md": (
        Box((0.008, 0.008, 0.015), (0.0, -0.016, 0.015)),
        Box((0.017, 0.011, 0.013), (0.0075, -0.035, 0.015)),
    ),
    "ds": (Box((0.009, 0.008, 0.014), (0.0, -0.012, 0.015)),),
}
COLLISION = {f"{f}_{link}": boxes for f in FINGERS[:3] for link, boxes in _FINGER_COLLISION.items()} | {
    "th_mp": (Box((0.017, 0.013, 0.011), (-0.0075, -0.0002, -0.011)),),
    "th_bs": (Box((0.009, 0.0165, 0.002), (0.0, 0.0, -0.0015)),),
    "th_px": (
        Box((0.01, 0.02, 0.012), (0.0, 0.0105, -0.014)),
        Box((0.007, 0.012, 0.015), (0.0, 0.04, -0.014)),
    ),
    "th_ds": (Box((0.01, 0.018, 0.012), (0.0, -0.0115, -0.015)),),
}
