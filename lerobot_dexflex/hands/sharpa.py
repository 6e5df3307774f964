"""SHARPA Wave hand (right, 22 DoF) in numbers.

Kinematics, inertias, limits, torques and speeds: `wave_01/right_sharpa_wave` of
`sharpa-robotics/sharpa-urdf-usd-xml` (Apache-2.0). Motors and collision shapes: MuJoCo Menagerie
`sharpa_wave` (Apache-2.0), mirrored from its left hand. Its cylinders are boxes here. So are the palm and the
metacarpal of the little finger, for which it has hulls: the bounding boxes of the vendor's meshes.

An early right hand of the Menagerie was made by mirroring and turned all joints the wrong way. In the frames
used here fingers bend for positive angles, toward +x of the palm, where the thumb stands: the pads therefore
look along +y of the distal links.
"""

import math

from lerobot_dexflex.hands.body import PALM, Box, Inertia, Link, Motor, Quaternion, Rod, Shape, Vector3
from lerobot_dexflex.hands.finger import Finger
from lerobot_dexflex.hands.hand import Hand

_AXIS = (0.0, 0.0, 1.0)
"""Every joint turns about z of its own link."""
_H, _S = 0.5, 0.7071
_ALONG_X: Quaternion = (1, 0, 1, 0)
"""Lays a rod along x of its link: the direction of the finger."""
_DAMPING_RATIO = 0.9
_GRIP_SHARE = 0.9
"""Share of a motor's torque that a grip uses."""


def _motor(
    torque: float, speed: float, gain: float, armature: float, friction_loss: float, damping: float
) -> Motor:
    """Return a motor whose velocity gain damps its own rotor by the Menagerie's damping ratio."""
    return Motor(
        position_gain=gain,
        velocity_gain=2 * _DAMPING_RATIO * math.sqrt(gain * armature),
        torque=torque,
        grip_torque=_GRIP_SHARE * torque,
        speed=speed,
        armature=armature,
        damping=damping,
        friction_loss=friction_loss,
    )


_CMC_FE = _motor(3.3, 11.841, 6.95, 0.0032, 0.132, 4.2e-5)
_CMC_AA = _motor(3.3, 11.841, 13.2, 0.0032, 0.132, 4.2e-5)
_PINKY_CMC = _motor(0.5285, 35.074, 1.38, 0.00012, 0.012, 4.2e-5)
_MCP_FE = _motor(1.864, 16.077, 4.76, 0.00265, 0.07456, 2.38e-5)
_MCP_AA = _motor(1.864, 16.077, 6.62, 0.00265, 0.07456, 2.38e-5)
_PIP = _motor(0.638, 11.618, 0.9, 0.0006, 0.01276, 4.06e-6)
_DIP = _motor(0.189369, 14.666, 0.9, 0.00042, 0.00378738, 1.21e-6)

_PALM_INERTIA = Inertia(
    0.6506,
    (-0.00216, 0.00536, 0.04011),
    (0.713832, -0.0659364, 0.0757239, 0.693082),
    (8.14964e-4, 6.74257e-4, 2.7314e-4),
)
_THUMB_KNUCKLE = Inertia(
    0.0025,
    (-0.00065, 0.0002, 0.0),
    (0.434754, 0.557664, -0.434754, 0.557664),
    (2.6e-7, 2.12661e-7, 1.34339e-7),
)
_THUMB_METACARPAL = Inertia(
    0.13587,
    (0.03643, -0.01024, 0.00517),
    (-0.151259, 0.696943, -0.154462, 0.683763),
    (4.69153e-5, 4.29066e-5, 1.92101e-5),
)
_THUMB_MIDDLE = Inertia(
    0.0025, (0.0, 0.0, 0.0), (0.515163, 0.484363, -0.515163, 0.484363), (2.6e-7, 2.12661e-7, 1.34339e-7)
)
_THUMB_PROXIMAL = Inertia(
    0.03078,
    (0.021256, -0.00095, -0.00092),
    (0.44358, 0.511613, 0.483631, 0.554609),
    (6.08344e-6, 5.91207e-6, 1.22148e-6),
)
_THUMB_DISTAL = Inertia(
    0.007981,
    (0.008218, -0.001777, -0.000997),
    (-0.255985, 0.713848, -0.187441, 0.624306),
    (1.0905e-6, 1.04136e-6, 2.95182e-7),
)
_KNUCKLE = Inertia(
    0.00221,
    (-0.0092, 0.0013, 0.0),
    (0.519686, 0.479506, -0.519686, 0.479506),
    (2.23e-7, 1.77435e-7, 1.09965e-7),
)
_PROXIMAL = Inertia(
    0.04741,
    (0.027, 0.00055, 0.00068),
    (0.512565, 0.504813, 0.502719, 0.479286),
    (1.14061e-5, 1.10467e-5, 2.15425e-6),
)
_MIDDLE = Inertia(
    0.01824,
    (0.01212, -0.00116, 0.00058),
    (-0.0266408, 0.732558, -0.0189273, 0.67992),
    (2.00683e-6, 1.9229e-6, 5.68878e-7),
)
_DISTAL = Inertia(
    0.004651,
    (0.012489, -0.002573, -0.000108),
    (-0.0492916, 0.716628, -0.0583643, 0.693259),
    (3.15336e-7, 3.09757e-7, 1.34861e-7),
)
_PINKY_METACARPAL = Inertia(
    0.12541,
    (0.0107985, 0.005988, -0.0335125),
    (0.706956, -0.000832, -0.0268047, 0.706749),
    (4.47765e-5, 3.72569e-5, 1.69876e-5),
)

_SPREAD = (-0.3491, 0.3491)
_FOLDED: Quaternion = (_S, -_S, 0, 0)
_UNFOLDED: Quaternion = (_S, _S, 0, 0)


def _phalanges(name: str, parent: str, knuckle: Vector3, mounted: Quaternion) -> tuple[Link, ...]:
    mcp, pp, mp, dp = (f"{name}_{part}" for part in ("MCP_VL", "PP", "MP", "DP"))
    return (
        Link(mcp, parent, knuckle, mounted, _KNUCKLE, f"{name}_MCP_FE", (-0.17453, 1.5708), _AXIS),
        Link(pp, mcp, (0.0, 0.0, 0.0), _FOLDED, _PROXIMAL, f"{name}_MCP_AA", _SPREAD, _AXIS),
        Link(mp, pp, (0.047, 0.0, 0.0), _UNFOLDED, _MIDDLE, f"{name}_PIP", (0.0, 1.7453), _AXIS),
        Link(dp, mp, (0.0315, 0.0, 0.0), (1, 0, 0, 0), _DISTAL, f"{name}_DIP", (0.0, 1.3963), _AXIS),
    )


def _shapes(proximal_radius: float, middle_radius: float) -> tuple[tuple[Shape, ...], ...]:
    return (
        (Box((0.01255, 0.01255, 0.0057), (0.00165, 0.00045, 0.0)),),
        (Rod(proximal_radius, 0.01725, (0.0305, 0.0, 0.0), _ALONG_X),),
        (Rod(middle_radius, 0.01472, (0.0147, -0.0012, 0.0), _ALONG_X),),
        (),
    )


def _finger(
    name: str,
    links: tuple[Link, ...],
    motors: tuple[Motor, ...],
    collision: tuple[tuple[Shape, ...], ...],
) -> Finger:
    """Return a finger other than the thumb; the pad is as long and as wide as its elastomer."""
    return Finger(
        name=name,
        prefix=name,
        links=links,
        motors=motors,
        collision=collision,
        tip=Rod(0.00806, 0.00535, (0.0139, -0.0009, 0.0), _ALONG_X),
        tip_position=(0.026009, 0.0, 0.0),
        pad_position=(0.0172, 0.00716, 0.0),
        pad_quaternion=_FOLDED,
        pad_half_size=(0.01, 0.0068),
    )


_MOUNTED: Quaternion = (_H, -_H, -_H, -_H)
_MOTORS = (_MCP_FE, _MCP_AA, _PIP, _DIP)
_INDEX = _finger(
    "index",
    _phalanges("index", PALM, (0.001, 0.0303, 0.0959), _MOUNTED),
    _MOTORS,
    _shapes(0.01048, 0.01042),
)
_MIDDLE_FINGER = _finger(
    "middle",
    _phalanges("middle", PALM, (0.0, 0.01, 0.0989), _MOUNTED),
    _MOTORS,
    _shapes(0.00935, 0.00941),
)
_RING = _finger(
    "ring",
    _phalanges("ring", PALM, (0.0015, -0.0103, 0.0929), _MOUNTED),
    _MOTORS,
    _shapes(0.00935, 0.00941),
)
_PINKY = _finger(
    "pinky",
    (
        Link(
            "pinky_MC",
            PALM,
            (0.01136, -0.0263, 0.0869),
            (0, 0, 0, 1),
            _PINKY_METACARPAL,
            "pinky_CMC",
            (0.0, 0.2618),
            _AXIS,
        ),
        *_phalanges("pinky", "pinky_MC", (0.00836, 0.0048, 0.0), (_H, _H, -_H, _H)),
    ),
    (_PINKY_CMC, *_MOTORS),
    ((Box((0.02225, 0.01225, 0.02225), (0.01205, 0.00755, -0.03345)),), *_shapes(0.00935, 0.00941)),
)
_THUMB = Finger(
    name="thumb",
    prefix="thumb",
    links=(
        Link(
            "thumb_CMC_VL",
            PALM,
            (0.01, 0.026, 0.0214),
            (0, _S, _S, 0),
            _THUMB_KNUCKLE,
            "thumb_CMC_FE",
            (-0.1745, 1.9199),
            _AXIS,
        ),
        Link(
            "thumb_MC",
            "thumb_CMC_VL",
            (0.0, -0.005, 0.0),
            (0.65328, -0.653282, 0.270598, 0.270599),
            _THUMB_METACARPAL,
            "thumb_CMC_AA",
            _SPREAD,
            _AXIS,
        ),
        Link(
            "thumb_MCP_VL",
            "thumb_MC",
            (0.065, -0.006, 0.010392),
            (0.965926, 0.25882, 0, 0),
            _THUMB_MIDDLE,
            "thumb_MCP_FE",
            (-0.5236, 1.3963),
            _AXIS,
        ),
        Link(
            "thumb_PP",
            "thumb_MCP_VL",
            (0.0, 0.0, 0.0),
            _FOLDED,
            _THUMB_PROXIMAL,
            "thumb_MCP_AA",
            _SPREAD,
            _AXIS,
        ),
        Link(
            "thumb_DP",
            "thumb_PP",
            (0.039, 0.0, 0.0),
            _UNFOLDED,
            _THUMB_DISTAL,
            "thumb_IP",
            (0.0, 1.7453),
            _AXIS,
        ),
    ),
    motors=(_CMC_FE, _CMC_AA, _MCP_FE, _MCP_AA, _PIP),
    collision=(
        (Box((0.01204, 0.01204, 0.00625), (0.00096, 0.00041, 0.0)),),
        (Rod(0.0207, 0.0169, (0.0398, -0.0107, 0.0111), _ALONG_X),),
        (),
        (Rod(0.0117, 0.0137, (0.0237, 0.0, -0.0012), _ALONG_X),),
        (),
    ),
    tip=Rod(0.00943, 0.00677, (0.0164, -0.0018, 0.0), _ALONG_X),
    tip_position=(0.027611, 0.0, 0.0),
    pad_position=(0.0211, 0.00763, 0.0),
    pad_quaternion=_FOLDED,
    pad_half_size=(0.0099, 0.0081),
)

_FINGERS = (_INDEX, _MIDDLE_FINGER, _RING, _PINKY, _THUMB)

SHARPA = Hand(
    name="sharpa",
    fingers=_FINGERS,
    opposing=("thumb",),
    palm_inertia=_PALM_INERTIA,
    palm_collision=(Box((0.02495, 0.0426, 0.0432), (0.00035, 0.0011, 0.0432)),),
    # The flange variant: 0.5 mm to the wrist and 29 mm to the palm, which continues the flange's axis.
    mount_position=(0.0, 0.0, 0.0295),
    mount_quaternion=(1, 0, 0, 0),
    relaxed_joints=(0.3, 0.0, 0.4, 0.2) * 3 + (0.0, 0.3, 0.0, 0.4, 0.2) + (0.5, 0.0, 0.2, 0.0, 0.2),
    nominal_joints=(0.54, 0.0, 0.31, 0.11) * 3
    + (0.1, 0.54, 0.0, 0.31, 0.11)
    + (1.64, 0.14, -0.27, 0.07, 0.0),
    idle_joints=(0.1, 0.0, 0.2, 0.1) * 3 + (0.0, 0.1, 0.0, 0.2, 0.1) + (0.0, 0.0, 0.0, 0.0, 0.1),
    # As wide as the elastomer of a finger; the real one is curved, the taxels here lie in a plane.
    taxels=(10, 6),
    taxel_pitch=(0.002, 0.0022),
    palmar=Box((0.014, 0.01, 0.006), (0.0, 0.0, -0.0045)),
    object_region=((0.06, -0.02, 0.115), (0.1, 0.04, 0.16)),
    pad_spacing=0.017,
    finger_order=(0.0, 1.0, 0.0),
    excluded=tuple((finger.distal, link.name) for finger in _FINGERS for link in finger.links[-4:-2]),
    # Fingers spread as a person's: an average open hand, a little larger than this one, fits to 7 mm.
    open_joints=(
        *(0.0, 0.1, 0.0, 0.0),
        *(0.0, 0.15, 0.0, 0.0),
        *(0.0, 0.25, 0.0, 0.0),
        *(0.0, 0.0, 0.3, 0.0, 0.0),
        *(0.0, 0.0, 0.7, 0.1, 0.4),
    ),
)
"""Right SHARPA Wave hand: index, middle, ring and little finger against the thumb."""
