"""How the operator holds the pitcher, tips it in the hand, and pours."""

import numpy as np
import pytest
from expert_checks import demonstrate, pads_of

from lerobot_dexflex.envs.pour_cup import BOWL_HEIGHT, BOWL_RADIUS, PITCHER_HEIGHT, PITCHER_RADIUS
from lerobot_dexflex.experts.pour_cup import (
    FULL_TILT,
    SPILL_TILT,
    TIPPED,
    palm_in_pitcher,
    pouring_pose,
)
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.hand.arm import rotation_vector
from lerobot_dexflex.hands import LEAP

HOLD = holds_of(LEAP).pitcher
NO_MIDDLE = 7
"""Seed of a pitcher that is gripped without the middle finger."""
MAX_JOINT_SPEED = np.pi
"""Of the xArm7's joints [rad/s] (UFACTORY: 180 degrees per second)."""


@pytest.fixture
def demonstration():
    return demonstrate("PourCup-v0")


def test_letting_go_comes_after_pouring():
    progress = demonstrate("PourCup-v0", 3).progress
    first = [int(np.argmax(progress >= stage / 6 - 1e-9)) for stage in range(1, 7)]
    assert first == sorted(first)
    assert first[5] - first[4] >= 10


@pytest.mark.parametrize(("seed", "idle"), [(11, []), (NO_MIDDLE, [1])])
def test_the_thumb_holds_against_the_fingers_that_were_drawn(seed, idle):
    shown = demonstrate("PourCup-v0", seed)
    gripped, held = shown.forces[shown.during(1, 2)], shown.forces[shown.during(2, 4)]
    assert ((gripped[:, np.setdiff1d(np.arange(4), idle)] > 0.05).mean(0) > 0.7).all()
    assert not gripped[:, idle].any()
    assert held[:, 3].mean() == pytest.approx(held[:, :3].sum(1).mean(), rel=0.5)


def test_fingers_right_the_pitcher_and_tip_it_while_pouring(demonstration):
    turns = np.array([rotation_vector(r @ palm_in_pitcher(HOLD.turn)) for r in demonstration.rotations])[:, 0]
    gripped = int(np.argmax(demonstration.progress > 0))
    assert turns[gripped] > 0.25  # The palm leans against the bar at yaw .18.
    assert np.abs(turns[gripped:]).min() < 0.02
    pouring = demonstration.during(3, 4)
    assert np.median(turns[pouring]) == pytest.approx(-TIPPED, abs=0.08)


def test_the_wrist_never_turns_faster_than_the_real_arm_can(demonstration):
    targets = np.array([command.joint_targets[:7] for command in demonstration.commands])
    assert np.abs(np.diff(targets, axis=0)).max() * 20 < MAX_JOINT_SPEED


def test_the_search_for_a_grip_begins_with_all_four_pads_flat_on_a_bar():
    centres, normals = pads_of(HOLD.touch)
    across = np.array([np.cos(HOLD.turn), 0.0, -np.sin(HOLD.turn)])
    side = np.array([1, 1, 1, -1])
    # The bar is 20 mm wide, along palm y through the grasp centre, turned about it.
    assert np.allclose((centres - HOLD.centre) @ across, side * 0.010, atol=1e-3)
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
