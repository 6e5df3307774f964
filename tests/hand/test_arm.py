"""Inverse kinematics of the wrist."""

import numpy as np
import pytest

from lerobot_dexflex.hand import xarm7
from lerobot_dexflex.hand.arm import ArmKinematics, rotation_matrix, rotation_vector
from lerobot_dexflex.hands import LEAP

POINT = np.array([-0.04, -0.035, -0.14])


@pytest.fixture
def kinematics():
    return ArmKinematics(LEAP, POINT, np.array(xarm7.HOME))


def test_rotation_vector_and_matrix_are_inverse():
    for vector in np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3)):
        assert np.allclose(rotation_vector(rotation_matrix(vector)), vector, atol=1e-9)
    quarter_turn = rotation_matrix(np.array([0, 0, np.pi / 2]))
    assert np.allclose(quarter_turn, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_near_poses_are_reached_within_a_tenth_of_a_millimetre_and_a_milliradian(kinematics):
    rng = np.random.default_rng(1)
    for _ in range(20):
        goal = np.array(xarm7.HOME) + rng.uniform(-0.2, 0.2, 7)
        position, rotation = kinematics.forward(goal)
        solved = kinematics.solve(np.array(xarm7.HOME), position, rotation, iterations=40, posture_gain=0.0)
        distance, angle = kinematics.error(solved, position, rotation)
        assert distance < 1e-4
        assert angle < 1e-3


def test_far_poses_are_reached_from_a_planar_seed(kinematics):
    seed = np.array([0, 0.40, 0, 0.75, 0, -1.2, np.pi / 2])
    position, rotation = kinematics.forward(seed + np.array([0.2, -0.1, 0.1, 0.2, -0.1, 0.2, 0.1]))
    distance, angle = kinematics.error(kinematics.reach(seed, position, rotation), position, rotation)
    assert distance < 1e-3
    assert angle < 5e-3
    assert np.array_equal(kinematics.posture, xarm7.HOME)


def test_unreachable_poses_stay_within_the_limits(kinematics):
    solved = kinematics.solve(np.array(xarm7.HOME), np.array([5.0, 0, 0]), np.eye(3), iterations=50)
    assert np.isfinite(solved).all()
    assert all(
        low <= q <= high for q, (low, high) in zip(solved, (k.joint_range for k in xarm7.LINKS), strict=True)
    )
