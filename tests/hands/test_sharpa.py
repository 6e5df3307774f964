"""The SHARPA Wave hand against the vendor's table and the Menagerie's model, typed in here a second time."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.arm import robot_model
from lerobot_dexflex.hands import SHARPA

S = 0.5**0.5
FOUR_FINGER_TIP, THUMB_TIP = (0.026009, 0, 0), (0.027611, 0, 0)


def phalanges(fold):
    return [((0, 0, 0), fold[0]), ((0.047, 0, 0), fold[1]), ((0.0315, 0, 0), (1, 0, 0, 0))]


FOLD = ((S, -S, 0, 0), (S, S, 0, 0))
# Position [m] and quaternion (w x y z) of each link in its parent; every joint turns about z of its link.
VENDOR = {
    "index": [((0.001, 0.0303, 0.0959), (0.5, -0.5, -0.5, -0.5)), *phalanges(FOLD)],
    "middle": [((0, 0.01, 0.0989), (0.5, -0.5, -0.5, -0.5)), *phalanges(FOLD)],
    "ring": [((0.0015, -0.0103, 0.0929), (0.5, -0.5, -0.5, -0.5)), *phalanges(FOLD)],
    "pinky": [
        ((0.01136, -0.0263, 0.0869), (0, 0, 0, 1)),
        ((0.00836, 0.0048, 0), (0.5, 0.5, -0.5, 0.5)),
        *phalanges(FOLD),
    ],
    "thumb": [
        ((0.01, 0.026, 0.0214), (0, S, S, 0)),
        ((0, -0.005, 0), (0.65328, -0.653282, 0.270598, 0.270599)),
        ((0.065, -0.006, 0.010392), (0.965926, 0.25882, 0, 0)),
        ((0, 0, 0), FOLD[0]),
        ((0.039, 0, 0), FOLD[1]),
    ],
}
# The Menagerie's right hand has mirrored frames (its commit 0f0d63e): its joints turn the other way.
MIRRORED = {
    "index": [((0.001, 0.0303, 0.0959), (0.5, 0.5, -0.5, 0.5)), *phalanges(FOLD)],
    "middle": [((0, 0.01, 0.0989), (0.5, 0.5, -0.5, 0.5)), *phalanges(FOLD)],
    "thumb": [
        ((0.01, 0.026, 0.0214), (S, 0, 0, S)),
        ((0, 0.005, 0), (0.65328, -0.653282, -0.270598, -0.270599)),
        ((0.065, 0.006, -0.010392), (0.965926, 0.25882, 0, 0)),
        ((0, 0, 0), FOLD[0]),
        ((0.039, 0, 0), FOLD[1]),
    ],
}


@pytest.fixture
def joints():
    return np.random.default_rng(3).uniform(SHARPA.joint_lower, SHARPA.joint_upper, (30, 22))


def tip_of(chain, angles, tip):
    """Return a fingertip in the palm frame [m], from the inside out."""
    point = np.array(tip, float)
    for (position, quaternion), angle in zip(reversed(chain), reversed(angles), strict=True):
        turned = Rotation.from_quat(quaternion, scalar_first=True) * Rotation.from_euler("z", angle)
        point = turned.apply(point) + position
    return point


@pytest.mark.parametrize(("table", "sign"), [(VENDOR, 1), (MIRRORED, -1)])
def test_fingertips_are_where_the_tables_put_them(joints, table, sign):
    tips = kernels.fingertips(SHARPA.tables, joints)
    for f, (name, own) in enumerate(zip(SHARPA.finger_names, SHARPA.finger_joints, strict=True)):
        if name in table:
            end = THUMB_TIP if name == "thumb" else FOUR_FINGER_TIP
            expected = [tip_of(table[name], sign * hand[own], end) for hand in joints]
            np.testing.assert_allclose(tips[:, f], expected, atol=1e-5)


def test_it_has_22_joints_in_five_fingers():
    assert [len(finger.links) for finger in SHARPA.fingers] == [4, 4, 4, 5, 5]
    assert SHARPA.joint_names[12:18] == (
        "pinky_CMC",
        "pinky_MCP_FE",
        "pinky_MCP_AA",
        "pinky_PIP",
        "pinky_DIP",
        "thumb_CMC_FE",
    )


def test_fingers_bend_and_look_toward_the_side_of_the_thumb():
    straight = np.zeros(22)
    bent = np.where([name.endswith("_FE") for name in SHARPA.joint_names], 0.5, 0.0)
    bent[-5:] = 0.0
    moved = kernels.fingertips(SHARPA.tables, bent) - kernels.fingertips(SHARPA.tables, straight)
    assert (moved[:4, 0] > 0.03).all()
    _, outward = kernels.pads(SHARPA.tables, straight)
    np.testing.assert_allclose(outward[:4], [[1.0, 0.0, 0.0]] * 4, atol=1e-4)
    centres, outward = kernels.pads(SHARPA.tables, np.array(SHARPA.nominal_joints))
    assert (outward[:4] @ outward[4] < -0.8).all()
    assert 0.03 < np.linalg.norm(centres[:2].mean(0) - centres[4]) < 0.08


def test_the_arm_carries_the_hand_without_sagging():
    model = robot_model(SHARPA)
    assert (model.nu, model.nmesh) == (7 + 22, 0)
    hand = SHARPA.palm_inertia.mass + sum(link.inertia.mass for link in SHARPA.links)
    assert hand == pytest.approx(1.243, abs=5e-3)
    data = mujoco.MjData(model)
    start = np.array([0.0, -0.247, 0.0, 0.909, 0.0, 1.15644, 0.0, *SHARPA.relaxed_joints])
    data.qpos[:] = data.ctrl[:] = start
    mujoco.mj_step(model, data, 500)
    assert np.abs(data.qpos - start).max() < 2e-3
    assert not data.ncon
