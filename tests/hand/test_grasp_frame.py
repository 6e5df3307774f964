"""Poses that are written for one palm mean the same for any other."""

from dataclasses import replace

import numpy as np
import pytest

from lerobot_dexflex.hand import kernels, xarm7
from lerobot_dexflex.hand.arm import ArmKinematics, arm_for
from lerobot_dexflex.hand.grasp_frame import flange_change, grasp_frame, palm_point, palm_turn
from lerobot_dexflex.hands import HANDS, LEAP, SHARPA

POINTS = np.random.default_rng(0).uniform(-0.2, 0.2, (5, 3))
ARMS = [(0.0, -0.1, 0.0, 0.95, 0.0, 1.05, np.pi / 2), (0.0, 0.05, 0.05, 0.3, 3.2, 1.35, -1.6)]


def test_for_the_hand_they_are_written_for_not_a_bit_changes():
    assert all(np.array_equal(palm_point(LEAP, point), point) for point in POINTS)
    assert np.array_equal(palm_turn(LEAP), np.eye(3))
    assert all(np.array_equal(arm_for(LEAP, arm), arm) for arm in (*ARMS, xarm7.HOME))


@pytest.mark.parametrize("hand", HANDS.values(), ids=HANDS)
def test_axes_are_a_frame_that_looks_from_the_fingers_to_those_that_oppose_them(hand):
    centre, axes = grasp_frame(hand)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    local = (kernels.pads(hand.tables, np.array(hand.nominal_joints))[0] - centre) @ axes
    opposing, opposed = local[list(hand.opposing_fingers)], local[list(hand.opposed_fingers)]
    assert opposing[:, 0].min() > opposed[:, 0].max() + 0.01
    assert (np.diff(opposed[:, 1]) < -0.01).all()


def test_the_thumb_decides_where_the_row_of_fingers_begins_the_other_way_round():
    turned = replace(SHARPA, finger_order=(0.0, -1.0, 0.0))
    np.testing.assert_allclose(grasp_frame(turned).axes, grasp_frame(SHARPA).axes, atol=1e-12)


@pytest.mark.parametrize("arm", ARMS)
def test_another_hand_on_the_arm_grasps_at_the_same_place_the_same_way(arm):
    found = []
    for hand in (LEAP, SHARPA):
        frame = grasp_frame(hand)
        joints = arm_for(hand, arm)
        position, palm = ArmKinematics(hand, frame.centre, joints).forward(joints)
        found.append((position, palm @ frame.axes))
        assert np.abs(joints[-1]) < np.pi
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-6)
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-6)


def test_a_mount_that_turns_and_shifts_the_hand_is_made_up_for_by_the_flange():
    assert np.allclose(flange_change(SHARPA).axes, np.diag([-1.0, -1.0, 1.0]))
    shifted = replace(SHARPA, mount_position=(0.01, 0.0, 0.0295))
    np.testing.assert_allclose(flange_change(SHARPA).centre - flange_change(shifted).centre, (0.01, 0, 0))
