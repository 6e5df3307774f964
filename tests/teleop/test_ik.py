import numpy as np
import pytest
from moving_hand import START, TIPS, bent, record

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.arm import robot_model, rotation_vector
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.streams.retarget import calibrate
from lerobot_dexflex.streams.wrist_frame import Frame
from lerobot_dexflex.teleop.ik import ARM_SPEED, RobotIK

DT = 0.02
LOW, HIGH = robot_model(LEAP).jnt_range.T
BENDING = [k for k, name in enumerate(robot_joints(LEAP)) if name.endswith(("_pip", "_dip"))]
SPEED = np.repeat([ARM_SPEED, LEAP.motors[0].speed], [7, 16])


@pytest.fixture
def ik():
    return RobotIK(LEAP, START)


def errors(ik, palm, tips):
    """Return how far the palm [m], its orientation [rad] and the worst fingertip [m] are from targets."""
    turn = rotation_vector(ik.palm.rotation @ palm.rotation.T)
    return np.array(
        [
            np.linalg.norm(ik.palm.position - palm.position),
            np.linalg.norm(turn),
            np.linalg.norm(ik.tips - tips, axis=1).max(),
        ]
    )


def test_where_the_robot_is_led_to_is_where_mujoco_has_it(ik):
    """The independent model: arm and hand together, as in the tasks."""
    import mujoco

    model = robot_model(LEAP)
    data = mujoco.MjData(model)
    data.qpos[:] = ik.joints
    mujoco.mj_kinematics(model, data)
    palm = data.body("palm")
    np.testing.assert_allclose(ik.palm.position, palm.xpos, atol=1e-9)
    np.testing.assert_allclose(ik.palm.rotation, palm.xmat.reshape(3, 3), atol=1e-9)
    tips = [(data.site(f"{f}_tip").xpos - palm.xpos) @ ik.palm.rotation for f in ("if", "mf", "rf", "th")]
    np.testing.assert_allclose(ik.tips, tips, atol=1e-9)
    np.testing.assert_allclose(ik.tips, fingertips(LEAP.tables, ik.joints[7:]), atol=1e-5)


def test_random_reachable_poses_are_reached(ik):
    """Within 0.5 mm and 2 mrad in 0.3 s, each joint up to 0.35 rad away."""
    rng, there = np.random.default_rng(0), RobotIK(LEAP, START)
    for _ in range(20):
        there.put(START + rng.uniform(-0.35, 0.35, 23))
        palm, tips = there.palm, there.tips
        ik.put(START)
        for _ in range(14):
            ik.solve(palm, tips, DT)
        np.testing.assert_array_equal(ik.solve(palm, tips, DT), ik.joints)
        assert (errors(ik, palm, tips) < (5e-4, 2e-3, 5e-4)).all()


def test_joints_stay_within_their_limits_and_speeds_wherever_targets_are(ik):
    rng = np.random.default_rng(1)
    for _ in range(20):
        rotation = turn(rng.normal(size=3))
        palm = Frame(rng.uniform(-1.5, 1.5, 3), rotation)
        tips = rng.uniform(-0.4, 0.4, (4, 3))
        for _ in range(20):
            before = ik.joints
            joints = ik.solve(palm, tips, DT)
            assert np.isfinite(joints).all()
            assert ((joints >= LOW) & (joints <= HIGH)).all()
            assert (np.abs(joints - before) <= SPEED * DT + 1e-9).all()


def turn(vector):
    import mujoco

    matrix, quaternion = np.zeros(9), np.zeros(4)
    angle = np.linalg.norm(vector)
    mujoco.mju_axisAngle2Quat(quaternion, vector / angle, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def test_out_of_reach_the_robot_comes_near_and_to_rest(ik):
    here, tips = ik.palm, ik.tips
    for away in ((0.8, 0.0, 0.0), (0.0, 0.9, 0.2), (0.3, -0.5, 0.6)):
        ik.put(START)
        palm = Frame(here.position + away, here.rotation)
        for _ in range(150):
            ik.solve(palm, tips, DT)
        before = ik.joints
        for _ in range(20):
            ik.solve(palm, tips, DT)
        assert np.abs(ik.joints - before).max() < 0.02  # [rad] in 0.4 s.
        assert errors(ik, palm, tips)[0] < 0.6 * np.linalg.norm(away)


def test_what_cannot_reach_slows_nothing_else(ik):
    alone, palm = RobotIK(LEAP, START), ik.palm
    far_palm, far = Frame(palm.position + 1.0, palm.rotation), np.zeros((4, 3))
    far[3] = (0.0, 0.3, -0.3)
    for k in range(30):
        bending = START[7:].copy()
        bending[0] += 0.01 * k  # The index at 0.5 rad/s.
        tips = fingertips(LEAP.tables, bending)
        ik.solve(far_palm, tips + far, DT)
        alone.solve(palm, tips, DT)
        assert np.linalg.norm(ik.tips[0] - tips[0]) < 1e-3
    np.testing.assert_array_equal(ik.joints[7:19], alone.joints[7:19])
    assert np.linalg.norm(ik.tips[3] - alone.tips[3]) > 0.05


def test_the_same_targets_give_the_same_fingers_whatever_was_before(ik):
    """A point leaves a joint of each finger free; the posture takes it."""
    rng, tips, found = np.random.default_rng(2), ik.tips, []
    for _ in range(2):
        for _ in range(100):
            ik.solve(None, fingertips(LEAP.tables, START[7:] + rng.uniform(-0.3, 0.3, 16)), DT)
        for _ in range(200):
            ik.solve(None, tips, DT)
        found.append(ik.joints)
    np.testing.assert_allclose(found[0], found[1], atol=0.02)


@pytest.mark.parametrize("seconds", [0.5, 1.0, 4.0])
def test_fingers_bend_forward_however_often_the_hand_opens_and_closes(ik, seconds):
    """Also out of reach, and from a start that bends back: the robot's relaxed hand does."""
    retargeting = calibrate(LEAP, record(0.0))
    for phase in np.arange(0.0, 4.0, DT / seconds):
        angle = 0.6 * (1 - np.cos(2 * np.pi * phase))
        joints = ik.solve(None, retargeting(bent(angle)[TIPS]), DT)
        if phase > 1.0:
            assert (joints[BENDING] > -1e-6).all()
    open_hand = retargeting(bent(0.0)[TIPS])
    for _ in range(50):
        ik.solve(None, open_hand, DT)
    off = np.linalg.norm(ik.tips - open_hand, axis=1)
    assert (off[[0, 2, 3]] < 2e-3).all()
    assert off[1] < 0.015  # The person's middle finger is longer.


def test_without_a_palm_target_the_arm_does_not_move_a_bit(ik):
    before = ik.joints
    for _ in range(5):
        ik.solve(None, ik.tips + 0.01, DT)
    np.testing.assert_array_equal(ik.joints[:7], before[:7])
    assert np.abs(ik.joints[7:] - before[7:]).max() > 0.01


def test_targets_that_are_not_finite_are_refused_and_nothing_moves(ik):
    before, palm, tips = ik.joints, ik.palm, ik.tips
    broken = tips.copy()
    broken[1, 2] = np.nan
    nowhere = Frame(np.array([0.0, np.inf, 0.0]), palm.rotation)
    for arguments in ((palm, broken, DT), (nowhere, tips, DT), (palm, tips, 0.0), (palm, tips, np.nan)):
        with pytest.raises(DexFlexError, match="must be finite and time positive"):
            ik.solve(*arguments)
    np.testing.assert_array_equal(ik.joints, before)


def test_a_robot_outside_of_its_limits_is_taken_at_them(ik):
    ik.put(np.full(23, 9.0))
    assert (ik.joints <= HIGH).all()
    assert (ik.joints >= HIGH - 2e-3).all()


def test_another_hands_palm_and_fingertips_are_led_too():
    """Five fingers of four and five joints; each tip to 0.5 mm, the palm to 1 mm, in 0.4 s."""
    rng = np.random.default_rng(0)
    arm = START[:7]
    ik = RobotIK(SHARPA, (*arm, *SHARPA.loose_joints))
    for _ in range(4):
        bent = np.clip(
            SHARPA.loose_joints + rng.uniform(-0.15, 0.15, SHARPA.n_joints),
            SHARPA.joint_lower + 2e-3,
            SHARPA.joint_upper - 2e-3,
        )
        there = RobotIK(SHARPA, (*(arm + rng.uniform(-0.15, 0.15, 7)), *bent))
        ik.put((*arm, *SHARPA.loose_joints))
        for _ in range(20):
            ik.solve(there.palm, there.tips, DT)
        assert ik.joints.shape == (7 + SHARPA.n_joints,)
        assert (errors(ik, there.palm, there.tips) < (1e-3, 4e-3, 5e-4)).all()
    np.testing.assert_allclose(ik.tips, fingertips(SHARPA.tables, ik.joints[7:]), atol=1e-5)
