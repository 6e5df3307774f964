"""A gloved hand follows an expert's fingertips, shaken by the glove."""

import numpy as np
import torch

from lerobot_dexflex.commands.families import NO_ERRORS, CommandErrors
from lerobot_dexflex.commands.glove import GlovedHand
from lerobot_dexflex.experts.command import Command
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


def commanded(errors, steps=3, seed=(7, 1)):
    """Return the commanded fingertips while an expert moves them by 1 mm per step, (steps, 4, 3)."""
    hand = GlovedHand(make_interface("raw"), errors, seed, START)
    joints = np.full(23, 0.6)
    moves = [Command(joints, TIPS + 0.001 * (k + 1), joints) for k in range(steps)]
    return np.stack([hand.move(OBSERVATION, command).fingertips for command in moves])


def test_without_errors_the_expert_is_followed():
    expected = TIPS + 0.001 * np.arange(1, 4)[:, None, None]
    np.testing.assert_allclose(commanded(NO_ERRORS), expected, atol=1e-12)


def test_the_gloves_jitter_is_drawn_from_its_seed_and_does_not_add_up():
    errors = CommandErrors.of(jitter=0.004)
    rng = np.random.default_rng((7, 1))
    expected = np.stack([rng.uniform(-0.004, 0.004, (4, 3)) for _ in range(3)])
    np.testing.assert_allclose(commanded(errors) - commanded(NO_ERRORS), expected, atol=1e-12)


def test_the_arm_and_its_unsteadiness_pass():
    hand = GlovedHand(make_interface("raw"), CommandErrors.of(jitter=0.004), 3, START)
    joints = np.arange(23) / 22.0
    got = hand.move(OBSERVATION, Command(joints, TIPS, joints + 0.01))
    np.testing.assert_array_equal(got.joint_targets[:7], joints[:7])
    np.testing.assert_allclose(got.executed - got.joint_targets, np.full(23, 0.01), atol=1e-12)
