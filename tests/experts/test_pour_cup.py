"""How the expert of PourCup holds the pitcher, and pours."""

import numpy as np
import pytest
from expert_checks import demonstrate, pads_of

from lerobot_dexflex.envs.pour_cup import BOWL_HEIGHT, BOWL_RADIUS, PITCHER_HEIGHT, PITCHER_RADIUS
from lerobot_dexflex.experts.pour_cup import (
    FULL_TILT,
    GRASP_CENTRE,
    GRASP_TURN,
    HAND_TOUCH,
    SPILL_TILT,
    pouring_pose,
)

MAX_JOINT_SPEED = np.pi
"""Of the xArm7's joints [rad/s] (UFACTORY: 180 degrees per second)."""


@pytest.fixture
def demonstration():
    return demonstrate("PourCup-v0")


def test_letting_go_comes_after_pouring(demonstration):
    progress = demonstration.progress
    first = [int(np.argmax(progress >= stage / 6 - 1e-9)) for stage in range(1, 7)]
    assert first == sorted(first)
    assert first[5] - first[4] >= 10


def test_expert_holds_with_all_four_fingers_and_the_thumb_balances_three(demonstration):
    held = demonstration.forces[75:185]
    assert (held.mean(0) > 1.0).all()
    assert held[:, 3].mean() == pytest.approx(held[:, :3].sum(1).mean(), rel=0.15)


def test_the_wrist_never_turns_faster_than_the_real_arm_can(demonstration):
    targets = np.array([command.joint_targets[:7] for command in demonstration.commands])
    assert np.abs(np.diff(targets, axis=0)).max() * 20 < MAX_JOINT_SPEED


def test_touch_posture_lays_all_four_pads_flat_on_the_bar():
    centres, normals = pads_of(HAND_TOUCH)
    across = np.array([np.cos(GRASP_TURN), 0.0, -np.sin(GRASP_TURN)])
    side = np.array([1, 1, 1, -1])
    # The bar is 20 mm wide, along palm y through the grasp centre, turned about it.
    assert np.allclose((centres - GRASP_CENTRE) @ across, side * 0.010, atol=1e-3)
    assert np.allclose(normals @ across, -side, atol=1e-3)


@pytest.mark.parametrize("tilt", [SPILL_TILT, 1.5, FULL_TILT])
def test_the_lip_is_over_the_bowl_and_no_part_of_the_pitcher_touches_it(tilt):
    bowl = np.array([0.35, -0.2, 0.0])
    position, rotation = pouring_pose(bowl, tilt)
    lip = position + rotation @ np.array([-PITCHER_RADIUS, 0.0, PITCHER_HEIGHT])
    assert np.linalg.norm(lip[:2] - bowl[:2]) < BOWL_RADIUS / 2
    angles = np.linspace(0, 2 * np.pi, 24)
    ring = PITCHER_RADIUS * np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
    rims = np.concatenate([ring, ring + np.array([0.0, 0.0, PITCHER_HEIGHT])])
    assert (position + rims @ rotation.T)[:, 2].min() > BOWL_HEIGHT + 0.02
    assert rotation[2, 2] == pytest.approx(np.cos(tilt))
