import numpy as np
import pytest
import torch

from lerobot_dexflex.commands.families import CommandErrors
from lerobot_dexflex.experts.command import Command, fingertips_of
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.teleop.hands import Hands, bends_forward

POSTURE = np.array(LEAP.loose_joints)


def observation(hand):
    joints = np.concatenate([np.zeros(7), hand]).astype(np.float32)
    return {"agent_pos": joints, "tactile": np.zeros(240), "fingertips": np.zeros(12), "gravity": np.zeros(3)}


def command(hand):
    joints = np.concatenate([np.full(7, 0.1), hand])
    return Command(joints, joints, np.tile(fingertips_of(LEAP, hand), (8, 1, 1)))


@pytest.mark.parametrize(
    ("hand", "forward"),
    [
        (LEAP.relaxed_joints, False),
        (np.zeros(16), False),
        (POSTURE, True),
        (POSTURE * ([1.0] * 6 + [0.0] * 2 + [1.0] * 8), False),
        (np.array([*(0.4, 0.0, 0.6, -0.3) * 3, *POSTURE[12:]]), False),
        (POSTURE * ([1.0] * 12 + [-9.0] * 4), True),
    ],
    ids=["relaxed", "straight", "bent", "a straight middle finger", "tips back", "whatever the thumb does"],
)
def test_fingers_must_bend_forward(hand, forward):
    assert bends_forward(LEAP, np.asarray(hand, float)) == forward


def test_the_interface_takes_over_when_the_fingers_bend_forward_and_keeps_the_hand():
    hands = Hands(make_interface(LEAP, "raw"))
    hand, goal = hands(0), POSTURE + 0.05
    relaxed, bent = np.array(LEAP.relaxed_joints), np.array(POSTURE)
    np.testing.assert_array_equal(hand.move(observation(relaxed), command(goal)).joint_targets[7:], goal)
    assert hands.motion is None
    solved = hand.move(observation(bent), command(goal)).joint_targets
    assert np.abs(solved[7:] - goal).max() > 1e-4  # Raw's own inverse kinematics.
    np.testing.assert_allclose(fingertips_of(LEAP, solved[7:]), fingertips_of(LEAP, goal), atol=2e-3)
    np.testing.assert_array_equal(solved[:7], np.full(7, 0.1))
    after = hand.move(observation(relaxed), command(goal)).joint_targets
    assert np.abs(after[7:] - goal).max() > 1e-4


def test_joints_pass_as_they_are():
    hand = Hands(make_interface(LEAP, "joint"))(0)
    goal = POSTURE + 0.05
    np.testing.assert_array_equal(hand.move(observation(POSTURE), command(goal)).joint_targets[7:], goal)


def test_the_view_sees_the_draft_and_what_the_interface_made_of_it():
    hands = Hands(make_interface(LEAP, "raw@0.5"))
    hands(0).move(observation(POSTURE), command(POSTURE + 0.05))
    motion = hands.motion
    assert motion is not None
    assert motion.draft.shape == (4, 3)
    np.testing.assert_allclose(motion.selected, 0.5 * motion.draft)


def test_a_simulated_person_is_led_by_the_interface_at_once_and_differs_by_attempt():
    torch.manual_seed(0)
    hands = Hands(make_interface(LEAP, "raw"), seed=3, errors=CommandErrors.parse("noise_4mm"))
    relaxed = np.array(LEAP.relaxed_joints)
    moved = [hands(k).move(observation(relaxed), command(relaxed)).joint_targets[7:] for k in (0, 1, 0)]
    assert np.abs(moved[0] - relaxed).max() > 1e-3
    assert np.abs(moved[0] - moved[1]).max() > 1e-3
    np.testing.assert_array_equal(moved[0], moved[2])
