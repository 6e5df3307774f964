"""A gloved hand follows an expert's fingertips, shaken by the glove."""

import numpy as np
import torch

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.glove import GlovedHand
from lerobot_dexflex.commands.human import HumanErrors
from lerobot_dexflex.commands.levels import LEVELS
from lerobot_dexflex.commands.stream import seeds_of
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.method import make_interface

START = np.full(16, 0.6)
TIPS = fingertips(LEAP, torch.as_tensor(START)[None])[0].numpy()
OBSERVATION = {
    "agent_pos": np.full(23, 0.6, np.float32),
    "tactile": np.zeros(240, np.float32),
    "fingertips": TIPS.reshape(-1).astype(np.float32),
    "gravity": np.array([0, 0, -1], np.float32),
}


class Listener:
    name = "listener"
    hand = LEAP
    command_space = "draft"
    motion = None

    def __init__(self):
        self.drafts = []

    def reset(self, mask=None):
        del mask

    def step(self, observation, draft):
        self.drafts.append(draft[0].numpy())
        return observation["observation.state"][:, -16:]


def told(errors, steps=3, seed=(7, 1), interface="raw"):
    """Return where the hand is told to be while an expert leads it 1 mm further in each step."""
    hand = GlovedHand(make_interface(LEAP, interface), errors, seed)
    joints = np.full(23, 0.6)
    moves = [Command(joints, joints, np.tile(TIPS + 0.001 * (k + 1), (8, 1, 1))) for k in range(steps)]
    return np.stack(
        [
            kernels.fingertips(LEAP.tables, hand.move(OBSERVATION, command).joint_targets[7:])
            for command in moves
        ]
    )


def test_without_errors_the_expert_is_followed():
    expected = TIPS + 0.001 * np.arange(1, 4)[:, None, None]
    np.testing.assert_allclose(told(NO_ERRORS), expected, atol=4e-4)  # The posture tie leaves some out.


def test_the_gloves_noise_is_drawn_from_its_seed_and_does_not_add_up():
    listener = Listener()
    hand = GlovedHand(listener, CommandErrors.of(noise=0.004), (7, 1))  # pyright: ignore[reportArgumentType]
    joints, rng = np.full(23, 0.6), np.random.default_rng((7, 1))
    rng.uniform(size=(4, 3))  # A bias and an onset are drawn for every family, needed or not.
    rng.integers(8, 20)
    for k in range(3):
        hand.move(OBSERVATION, Command(joints, joints, np.tile(TIPS + 0.001 * k, (8, 1, 1))))
        expected = 0.001 * k + rng.uniform(-0.004, 0.004, (4, 3))
        np.testing.assert_allclose(listener.drafts[k], np.tile(expected, (8, 1, 1)), atol=1e-6)


def test_what_is_recorded_is_what_moved_the_hand():
    hand = GlovedHand(make_interface(LEAP, "press:3"), NO_ERRORS, 3)
    touched = OBSERVATION | {"tactile": np.full(240, 0.02, np.float32)}
    joints = np.full(23, 0.6)
    got = hand.move(touched, Command(joints, joints, np.tile(TIPS, (8, 1, 1))))
    assert np.abs(kernels.fingertips(LEAP.tables, got.joint_targets[7:]) - TIPS).max() > 0.003  # It presses.


def test_the_arm_and_its_unsteadiness_pass():
    hand = GlovedHand(make_interface(LEAP, "raw"), CommandErrors.of(noise=0.004), 3)
    joints = np.arange(23) / 22.0
    got = hand.move(OBSERVATION, Command(joints, joints + 0.01, np.tile(TIPS, (8, 1, 1))))
    np.testing.assert_array_equal(got.joint_targets[:7], joints[:7])
    np.testing.assert_allclose(got.executed - got.joint_targets, np.full(23, 0.01), atol=1e-12)


def test_events_of_the_glove_are_told():
    hand = GlovedHand(make_interface(LEAP, "raw"), CommandErrors.of(freeze=5), 3)
    joints = np.full(23, 0.6)
    for _ in range(30):
        hand.move(OBSERVATION, Command(joints, joints, np.tile(TIPS, (8, 1, 1))))
    assert next((event.family, event.end - event.onset) for event in hand.events) == ("freeze", 5)


def pressed(errors, source, slips, seed=3):
    """Return what arrives at the interface of an operator that stands still and squeezes by 2 mm and more."""
    listener = Listener()
    hand = GlovedHand(listener, errors, seed, source)  # pyright: ignore[reportArgumentType]
    joints = np.concatenate([np.zeros(7), START + 0.05])
    for slipping in slips:
        hand.move(OBSERVATION, Command(joints, joints, np.tile(TIPS, (8, 1, 1)), slipping))
    return np.array(listener.drafts)


SQUEEZE = kernels.fingertips(LEAP.tables, START + 0.05) - TIPS


def test_a_motion_source_leaves_the_squeeze_out_and_a_pressing_one_puts_it_in():
    assert np.abs(SQUEEZE).max() > 0.002
    np.testing.assert_allclose(pressed(NO_ERRORS, "motion", [False] * 3), 0, atol=1e-6)
    found = pressed(NO_ERRORS, "pressing", [False] * 3)
    np.testing.assert_allclose(found, np.tile(SQUEEZE, (3, 8, 1, 1)), atol=1e-6)


def test_a_person_presses_as_chosen_until_a_slip_is_seen():
    errors, slips = CommandErrors.parse("novice"), [False] * 30 + [True] + [False] * 20
    human = HumanErrors(LEAP, LEVELS["novice"], np.random.default_rng(seeds_of(errors, 3)[0]))
    chosen = human.squeeze(False)
    offset = pressed(errors, "pressing", slips) - pressed(errors, "motion", slips)
    factor = (offset * SQUEEZE).sum((1, 2, 3)) / (8 * (SQUEEZE**2).sum())
    np.testing.assert_allclose(factor[:30], chosen, atol=1e-6)  # Whatever the person's scale.
    assert abs(chosen - 1) > 0.05
    np.testing.assert_allclose(factor[-4:], 1, atol=1e-6)
    assert not np.allclose(factor[33:36], factor[-1], atol=1e-3)  # Not at once.


def test_joints_pass_bit_for_bit_without_errors_and_are_spoilt_with_them():
    joints, rng = np.full(23, 0.6), np.random.default_rng(0)
    command = Command(joints, joints + 0.3 * rng.normal(size=23), np.tile(TIPS, (8, 1, 1)))
    assert GlovedHand(make_interface(LEAP, "joint"), NO_ERRORS, 3).move(OBSERVATION, command) is command
    got = GlovedHand(make_interface(LEAP, "joint"), CommandErrors.parse("typical"), 3).move(
        OBSERVATION, command
    )
    np.testing.assert_array_equal(got.joint_targets[:7], joints[:7])
    assert 1e-4 < np.abs(kernels.fingertips(LEAP.tables, got.joint_targets[7:]) - TIPS).max() < 0.01


def test_another_seed_is_another_person():
    one, same, other = (told(CommandErrors.parse("typical"), seed=seed) for seed in ((7, 1), (7, 1), (7, 2)))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 1e-4
