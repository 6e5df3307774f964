"""UFACTORY xArm7 in numbers (source: MuJoCo Menagerie `ufactory_xarm7/xarm7_nohand.xml`, BSD-3-Clause).

Only numbers are taken over. Collision capsules are our own approximation.
"""

from typing import NamedTuple

from lerobot_dexflex.hands.body import Capsule, Inertia, Link

HOME = (0.0, -0.247, 0.0, 0.909, 0.0, 1.15644, 0.0)
"""Home configuration [rad]: flange at (0.400, 0, 0.400) m above `link_base`, pointing down."""

JOINT_AXIS = (0.0, 0.0, 1.0)
ARMATURE = 0.1
FRICTION_LOSS = 1.0


class Drive(NamedTuple):
    """Position servo of one joint size class."""

    damping: float
    """Joint damping [N m s/rad]."""
    kp: float
    """Position gain [N m/rad]."""
    kv: float
    """Velocity gain [N m s/rad]; kv/kp = 0.1 s of tracking lag."""
    torque: float
    """Torque limit [N m]."""


_LARGE = Drive(10.0, 1500.0, 150.0, 50.0)
_MEDIUM = Drive(5.0, 1000.0, 100.0, 30.0)
_SMALL = Drive(2.0, 800.0, 80.0, 20.0)
DRIVES = (_LARGE, _LARGE, _MEDIUM, _MEDIUM, _MEDIUM, _SMALL, _SMALL)

BASE_INERTIA = Inertia(
    0.88556,
    (-0.021131, -0.0016302, 0.056488),
    (0.696843, 0.20176, 0.10388, 0.680376),
    (0.00382023, 0.00335282, 0.00167725),
)

_TURN = (-6.28319, 6.28319)

LINKS = (
    Link(
        "link1",
        "link_base",
        (0.0, 0.0, 0.267),
        (1, 0, 0, 0),
        Inertia(
            2.382,
            (-0.0002, 0.02905, -0.01233),
            (0.978953, -0.202769, -0.00441617, -0.0227264),
            (0.00569127, 0.00533384, 0.00293865),
        ),
        "joint1",
        _TURN,
        JOINT_AXIS,
    ),
    Link(
        "link2",
        "link1",
        (0.0, 0.0, 0.0),
        (1, -1, 0, 0),
        Inertia(
            1.869,
            (0.00022, -0.12856, 0.01735),
            (0.50198, 0.86483, -0.00778841, 0.00483285),
            (0.00959898, 0.00937717, 0.00201315),
        ),
        "joint2",
        (-2.059, 2.0944),
        JOINT_AXIS,
    ),
    Link(
        "link3",
        "link2",
        (0.0, -0.293, 0.0),
        (1, 1, 0, 0),
        Inertia(
            1.6383,
            (0.0466, -0.02463, -0.00768),
            (0.913819, 0.289775, 0.281481, -0.0416455),
            (0.00351721, 0.00294089, 0.00195868),
        ),
        "joint3",
        _TURN,
        JOINT_AXIS,
    ),
    Link(
        "link4",
        "link3",
        (0.0525, 0.0, 0.0),
        (1, 1, 0, 0),
        Inertia(
            1.7269,
            (0.07047, -0.11575, 0.012),
            (0.422108, 0.852026, -0.126025, 0.282832),
            (0.00657137, 0.00647948, 0.00186763),
        ),
        "joint4",
        (-0.19198, 3.927),
        JOINT_AXIS,
    ),
    Link(
        "link5",
        "link4",
        (0.0775, -0.3425, 0.0),
        (1, 1, 0, 0),
        Inertia(
            1.3203,
            (-0.00032, 0.01604, -0.026),
            (0.999311, -0.0304457, 0.000577067, 0.0212082),
            (0.00534729, 0.00499076, 0.0013489),
        ),
        "joint5",
        _TURN,
        JOINT_AXIS,
    ),
    Link(
        "link6",
        "link5",
        (0.0, 0.0, 0.0),
        (1, 1, 0, 0),
        Inertia(
            1.325,
            (0.06469, 0.03278, 0.02141),
            (-0.217672, 0.772419, 0.16258, 0.574069),
            (0.00245421, 0.00221646, 0.00107273),
        ),
        "joint6",
        (-1.69297, 3.14159),
        JOINT_AXIS,
    ),
    Link(
        "link7",
        "link6",
        (0.076, 0.097, 0.0),
        (1, -1, 0, 0),
        Inertia(
            0.17,
            (0.0, -0.00677, -0.01098),
            (0.487612, 0.512088, -0.512088, 0.487612),
            (0.000132176, 0.000093, 0.0000585236),
        ),
        "joint7",
        _TURN,
        JOINT_AXIS,
    ),
)

COLLISION = {
    "link_base": (Capsule((0, 0, 0.03), (0, 0, 0.22), 0.06),),
    "link1": (Capsule((0, 0, -0.05), (0, 0, 0.02), 0.055),),
    "link2": (
        Capsule((0, 0, 0.03), (0, -0.02, 0.05), 0.055),
        Capsule((0, -0.05, 0.06), (0, -0.22, 0.06), 0.05),
    ),
    "link3": (
        Capsule((0, 0, -0.07), (0.03, 0, -0.02), 0.05),
        Capsule((0.045, -0.02, 0), (0.0525, -0.03, 0), 0.05),
    ),
    "link4": (Capsule((0.03, -0.02, 0.05), (0.075, -0.2, 0.05), 0.045),),
    "link5": (Capsule((0, 0, -0.12), (0, 0, -0.01), 0.042),),
    "link6": (
        Capsule((0, 0.03, 0), (0.076, 0.03, 0), 0.045),
        Capsule((0.076, 0.04, 0), (0.076, 0.06, 0), 0.04),
    ),
    "link7": (Capsule((0, 0, -0.03), (0, 0, -0.02), 0.036),),
}
