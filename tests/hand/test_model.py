"""The compiled robot agrees with the tables and with the vendor's forward kinematics."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.hand import xarm7
from lerobot_dexflex.hand.arm import robot_model
from lerobot_dexflex.hand.model import SUBSTEPS, TIMESTEP, robot_joints
from lerobot_dexflex.hands import LEAP

# Joints, palm position, palm quaternion (up to sign) and four fingertips, computed with MuJoCo Menagerie's
# meshed models: link_base at the origin, palm at the flange + (0.065, -0.04, 0), quaternion (0 1 0 0).
_A = "0.3 -0.5 0.2 1.2 -0.4 1.4 0.7 0.5 0.1 0.6 0.3 0.4 -0.1 0.7 0.2 0.6 0.2 0.5 0.4 0.9 0.4 0.3 -0.5"
_B = "-0.8 0.3 0.5 1.9 0.6 0.9 -1.2 1.2 -0.4 0.9 0.8 1 0.3 1.1 0.6 0.2 0 1.5 1 1.6 1.2 0.8 0.9"
VENDOR = {
    "zero": (
        [0.0] * 23,
        (0.27100, 0.04000, 0.12050),
        (-1, 0, 0, 0),
        ((0.40320, 0.04760, 0.10100), (0.40310, 0.00220, 0.10100), (0.40310, -0.04320, 0.10100)),
        (0.18870, 0.17670, 0.09860),
    ),
    "home": (
        [*xarm7.HOME, *[0.0] * 16],
        (0.46491, 0.04000, 0.39978),
        (-1, 0, -0.00022, 0),
        ((0.59711, 0.04760, 0.38022), (0.59701, 0.00220, 0.38022), (0.59701, -0.04320, 0.38022)),
        (0.38261, 0.17670, 0.37792),
    ),
    "A": (
        [float(x) for x in _A.split()],
        (0.36615, 0.18546, 0.63070),
        (-0.95440, 0.12477, 0.25382, 0.09549),
        ((0.47855, 0.14177, 0.55715), (0.47467, 0.11358, 0.57146), (0.44871, 0.04781, 0.56770)),
        (0.37619, 0.23613, 0.46692),
    ),
    "B": (
        [float(x) for x in _B.split()],
        (0.55207, -0.15352, 0.66175),
        (-0.83423, -0.01852, 0.48101, -0.26897),
        ((0.60777, -0.12903, 0.55289), (0.64744, -0.17736, 0.57508), (0.65801, -0.20155, 0.62981)),
        (0.63415, -0.22935, 0.60213),
    ),
}


@pytest.mark.parametrize("name", VENDOR)
def test_forward_kinematics_agrees_with_the_vendor_model_within_a_tenth_of_a_millimetre(name):
    joints, palm, quaternion, fingers, thumb = VENDOR[name]
    model = robot_model(LEAP)
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(model, data)
    assert np.abs(data.body("palm").xpos - palm).max() < 1e-4
    assert abs(data.body("palm").xquat @ np.array(quaternion)) == pytest.approx(1, abs=1e-5)
    for finger, tip in zip(LEAP.prefixes, (*fingers, thumb), strict=True):
        assert np.abs(data.site(f"{finger}_tip").xpos - tip).max() < 1e-4, finger


def test_joints_and_actuators_come_in_the_documented_order():
    model = robot_model(LEAP)
    assert [model.joint(k).name for k in range(model.njnt)] == list(robot_joints(LEAP))
    assert [model.actuator(k).name for k in range(model.nu)] == list(robot_joints(LEAP))
    assert LEAP.joint_names[:4] == ("if_mcp", "if_rot", "if_pip", "if_dip")
    assert LEAP.joint_names[12:] == ("th_cmc", "th_axl", "th_mcp", "th_ipl")


def test_masses_limits_and_gains_are_those_of_the_tables():
    model = robot_model(LEAP)
    hand = LEAP.palm_inertia.mass + sum(link.inertia.mass for link in LEAP.links)
    assert hand == pytest.approx(0.746)
    arm = xarm7.BASE_INERTIA.mass + sum(link.inertia.mass for link in xarm7.LINKS)
    assert model.body_mass.sum() == pytest.approx(hand + arm)
    for link in (*xarm7.LINKS, *LEAP.links):
        assert tuple(model.joint(link.joint).range) == link.joint_range
        assert tuple(model.body(link.name).inertia) == link.inertia.diagonal
    gains = {name: model.actuator(name) for name in ("joint1", "joint7", "th_ipl")}
    assert [gains[name].gainprm[0] for name in gains] == [1500, 800, 3]
    assert [-gains[name].biasprm[2] for name in gains] == [150, 80, 0.01]
    assert [gains[name].forcerange[1] for name in gains] == [50, 20, 0.6]


def test_the_model_has_no_meshes_and_the_control_rate_is_20_hz():
    model = robot_model(LEAP)
    assert model.nmesh == 0
    assert model.opt.timestep * SUBSTEPS == pytest.approx(0.05)
    assert model.opt.timestep == TIMESTEP


def test_the_arm_carries_the_hand_without_sagging():
    model = robot_model(LEAP)
    data = mujoco.MjData(model)
    start = np.array([*xarm7.HOME, *[0.3] * 16])
    data.qpos[:] = data.ctrl[:] = start
    mujoco.mj_step(model, data, 500)
    assert np.abs(data.qpos - start).max() < 1e-3


def test_pad_frames_point_outward_toward_the_tip_and_across():
    model = robot_model(LEAP)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for finger in LEAP.prefixes:
        distal = data.body(f"{finger}_ds").xmat.reshape(3, 3)
        pad = distal.T @ data.site(f"{finger}_pad").xmat.reshape(3, 3)
        assert np.allclose(pad, [[0, 0, -1], [-1, 0, 0], [0, 1, 0]], atol=1e-9)
