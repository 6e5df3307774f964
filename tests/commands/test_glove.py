"""A gloved hand follows an expert's fingertips, shaken by the glove."""

import numpy as np
import torch

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.glove import GlovedHand
from lerobot_dexflex.experts.command import Command
from lerobot_dexflex.hand import kernels
from lerobot_dexflex.hand.kinematics import fingertips
from lerobot_dexflex.interfaces.method import make_interface

START = np.full(16, 0.6)
TIPS = fingertips(torch.as_tensor(START)[None])[0].numpy()
OBSERVATION = {
    "agent_pos": np.full(23, 0.6, np.float32),
    "tactile": np.zeros(240, np.float32),
    "fingertips": TIPS.reshape(-1).astype(np.float32),
    "gravity": np.array([0, 0, -1], np.float32),
}


def told(errors, steps=3, seed=(7, 1), interface="raw"):
    """Return where the hand is told to be while an expert leads it 1 mm further in each step."""
    hand = GlovedHand(make_interface(interface), errors, seed)
    joints = np.full(23, 0.6)
    moves = [Command(joints, TIPS + 0.001 * (k + 1), joints) for k in range(steps)]
    return np.stack([hand.move(OBSERVATION, command).fingertips for command in moves])


def test_without_errors_the_expert_is_followed():
    expected = TIPS + 0.001 * np.arange(1, 4)[:, None, None]
    np.testing.assert_allclose(told(NO_ERRORS), expected, atol=4e-4)  # The posture tie leaves some out.


def test_the_gloves_noise_is_drawn_from_its_seed_and_does_not_add_up():
    class Listener:
        name = "listener"
        command_space = "draft"
        motion = None

        def __init__(self):
            self.drafts = []

        def reset(self, mask=None):
            del mask

        def step(self, observation, draft):
            self.drafts.append(draft[0].numpy())
            return observation["observation.state"][:, -16:]

    listener = Listener()
    hand = GlovedHand(listener, CommandErrors.of(noise=0.004), (7, 1))  # pyright: ignore[reportArgumentType]
    joints, rng = np.full(23, 0.6), np.random.default_rng((7, 1))
    rng.uniform(size=(4, 3))  # A bias and an onset are drawn for every family, needed or not.
    rng.integers(8, 20)
    for k in range(3):
        hand.move(OBSERVATION, Command(joints, TIPS + 0.001 * k, joints))
        expected = 0.001 * k + rng.uniform(-0.004, 0.004, (4, 3))
        np.testing.assert_allclose(listener.drafts[k], np.tile(expected, (8, 1, 1)), atol=1e-6)


def test_what_is_recorded_is_what_moved_the_hand():
    hand = GlovedHand(make_interface("press:3"), NO_ERRORS, 3)
    touched = OBSERVATION | {"tactile": np.full(240, 0.02, np.float32)}
    joints = np.full(23, 0.6)
    got = hand.move(touched, Command(joints, TIPS, joints))
    np.testing.assert_array_equal(got.fingertips, kernels.fingertips(got.joint_targets[7:]))
    assert np.abs(got.fingertips - TIPS).max() > 0.003  # It presses.


def test_the_arm_and_its_unsteadiness_pass():
    hand = GlovedHand(make_interface("raw"), CommandErrors.of(noise=0.004), 3)
    joints = np.arange(23) / 22.0
    got = hand.move(OBSERVATION, Command(joints, TIPS, joints + 0.01))
    np.testing.assert_array_equal(got.joint_targets[:7], joints[:7])
    np.testing.assert_allclose(got.executed - got.joint_targets, np.full(23, 0.01), atol=1e-12)


def test_events_of_the_glove_are_told():
    hand = GlovedHand(make_interface("raw"), CommandErrors.of(freeze=5), 3)
    joints = np.full(23, 0.6)
    for _ in range(30):
        hand.move(OBSERVATION, Command(joints, TIPS, joints))
    assert next((event.family, event.end - event.onset) for event in hand.events) == ("freeze", 5)
