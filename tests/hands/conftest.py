import math

import numpy as np
import pytest

from lerobot_dexflex.hands import Finger, Hand
from lerobot_dexflex.hands.body import Box, Inertia, Link, Motor, Rod

INERTIA = Inertia(0.02, (0.01, 0.0, 0.0), (1, 0, 0, 0), (1e-5, 1e-5, 1e-5))
MOTOR = Motor(2.0, 0.01, 0.8, 0.5, 6.0, 1e-3, 0.02, 1e-3)
SLANTED = (2 / 7, -3 / 7, 6 / 7)
"""A unit vector along none of the frame's axes."""
AXES = {
    3: ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), SLANTED),
    5: ((0.0, 0.0, -1.0), SLANTED, (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.6, 0.8)),
    4: ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)),
}
"""Of fingers of as many joints."""


def finger(name, joints, knuckle):
    parents = ("palm", *[f"{name}_{k}" for k in range(joints - 1)])
    links = tuple(
        Link(
            f"{name}_{k}",
            parent,
            (0.03 + 0.002 * k, 0.004 * k, -0.003) if k else knuckle,
            (1.0, 0.3 * k, -0.2, 0.1 * joints),
            INERTIA,
            f"{name}_joint{k}",
            (-0.8 - 0.1 * k, 1.2 + 0.1 * k),
            axis,
        )
        for k, (parent, axis) in enumerate(zip(parents, AXES[joints], strict=True))
    )
    return Finger(
        name=name,
        prefix=name[:2],
        links=links,
        motors=(MOTOR,) * joints,
        collision=((Box((0.01, 0.005, 0.005), (0.015, 0.0, 0.0)),),) * joints,
        tip=Rod(0.007, 0.005, (0.025, 0.0, 0.0), (1, 0, 1, 0)),
        tip_position=(0.03, 0.002, -0.001),
        pad_position=(0.02, -0.006, 0.001),
        pad_quaternion=(0.5, 0.4, 0.7, -0.1 * joints),
        pad_half_size=(0.01, 0.006),
    )


@pytest.fixture
def ragged():
    """A hand of three fingers with three, five and four joints, hardly one about -z of its link."""
    fingers = (
        finger("left", 3, (0.02, 0.04, 0.1)),
        finger("thumb", 5, (-0.03, 0.05, 0.02)),
        finger("right", 4, (0.01, -0.03, 0.11)),
    )
    return Hand(
        name="ragged",
        fingers=fingers,
        opposing=("thumb",),
        palm_inertia=INERTIA,
        palm_collision=(Box((0.02, 0.04, 0.04), (0.0, 0.0, 0.04)),),
        mount_position=(0.0, 0.0, 0.03),
        mount_quaternion=(1, 0, 0, 0),
        relaxed_joints=(0.1,) * 12,
        nominal_joints=tuple(0.05 * k for k in range(12)),
        idle_joints=(0.0,) * 12,
        taxels=(6, 4),
        taxel_pitch=(0.002, 0.003),
        palmar=Box((0.012, 0.008, 0.005), (0.0, 0.0, -0.003)),
        object_region=((-0.02, -0.05, 0.1), (0.05, 0.05, 0.2)),
        pad_spacing=0.015,
        finger_order=(0.0, math.sqrt(0.5), math.sqrt(0.5)),
        excluded=(("left_0", "left_2"), ("palm", "thumb_1")),
    )


@pytest.fixture
def joints(ragged):
    """Joints of 40 hands within their limits [rad]. Shape (40, 12)."""
    return np.random.default_rng(0).uniform(ragged.joint_lower, ragged.joint_upper, (40, ragged.n_joints))
