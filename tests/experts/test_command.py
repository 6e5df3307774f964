"""Fingertips and joints turn into each other, and the unsteadiness is as documented."""

import numpy as np
import pytest

from lerobot_dexflex.experts.command import (
    Command,
    FingertipExecutor,
    Unsteadiness,
    fingertips_of,
    min_jerk,
    through_glove,
)
from lerobot_dexflex.experts.place_hammer import HAND_TOUCH


def test_unsteadiness_has_the_documented_size_and_correlation():
    noise = Unsteadiness(np.random.default_rng(0), np.full(2000, 0.01))
    values = np.array([noise.step() for _ in range(60)])[30:]
    assert values.std() == pytest.approx(0.01, rel=0.05)
    assert np.corrcoef(values[:-1].ravel(), values[1:].ravel())[0, 1] == pytest.approx(0.9, abs=0.02)


def test_min_jerk_starts_and_ends_at_rest_and_is_symmetric():
    assert [min_jerk(0), min_jerk(0.5), min_jerk(1)] == [0, 0.5, 1]
    assert min_jerk(0.01) < 1e-4


def test_fingertips_and_executor_are_inverse_near_the_posture():
    joints = np.array(HAND_TOUCH)
    assert np.allclose(FingertipExecutor(joints).step(fingertips_of(joints)), joints, atol=1e-9)


def test_a_glove_shakes_fingertips_and_their_joints_but_neither_arm_nor_unsteadiness():
    joints = np.concatenate([np.arange(7) / 10, np.array(HAND_TOUCH)])
    steady = [Command(joints, fingertips_of(joints[7:]), joints + 0.01)] * 50
    passed = list(through_glove(iter(steady), joints[7:], 0.004, np.random.default_rng(0)))
    offsets = np.array([command.fingertips for command in passed]) - steady[0].fingertips
    assert 0.0035 < np.abs(offsets).max() <= 0.004
    assert np.abs(offsets.mean(0)).max() < 0.0012
    for command in passed:
        np.testing.assert_array_equal(command.joint_targets[:7], joints[:7])
        np.testing.assert_allclose(command.executed - command.joint_targets, 0.01, atol=1e-12)
    reached = np.array([fingertips_of(command.joint_targets[7:]) for command in passed])
    # The executor ties its posture to the previous one and so passes on about four fifths of a jump.
    assert 0.5 < np.std(reached - steady[0].fingertips) / np.std(offsets) < 1.1
