"""The scripted expert and the promise that replaying its fingertips reproduces the episode."""

import numpy as np
import pytest
import torch

from lerobot_dexflex.envs.place_hammer import PlaceHammerEnv
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.command import FingertipExecutor, Unsteadiness, fingertips_of, min_jerk
from lerobot_dexflex.experts.place_hammer import GRASP_CENTRE, HAND_TOUCH
from lerobot_dexflex.hand.kinematics import pads

SEED = 11


def run(seed: int):
    env = PlaceHammerEnv(cameras=())
    env.reset(seed=seed)
    commands, info, forces = [], {}, []
    for command in make_expert("PlaceHammer-v0")(env, np.random.default_rng(seed)):
        commands.append(command)
        *_, done, _, info = env.step(command.executed)
        forces.append(env.pad_forces)
        if done:
            break
    return env, commands, info, np.array(forces)


@pytest.fixture(scope="module")
def demonstration():
    return run(SEED)


def test_expert_hangs_the_hammer(demonstration):
    _, commands, info, _ = demonstration
    assert info["is_success"]
    assert info["progress"] == 1
    assert len(commands) < 230


def test_expert_squeezes_with_all_four_fingers_and_the_thumb_balances_three(demonstration):
    *_, forces = demonstration
    held = forces[80:140]
    assert (held > 0.5).all()
    assert held[:, 3].mean() == pytest.approx(held[:, :3].sum(1).mean(), rel=0.35)


def test_executing_the_commanded_fingertips_gives_the_recorded_joints(demonstration):
    env, commands, *_ = demonstration
    env.reset(seed=SEED)
    executor = FingertipExecutor(env.command[7:])
    for command in commands:
        assert np.array_equal(executor.step(command.fingertips), command.joint_targets[7:])


def test_replaying_the_recorded_commands_without_noise_succeeds(demonstration):
    env, commands, *_ = demonstration
    _, info = env.reset(seed=SEED)
    for command in [*commands, *[commands[-1]] * 20]:
        *_, done, _, info = env.step(command.joint_targets)
        if done:
            break
    assert info["is_success"]


def test_touch_posture_lays_all_four_pads_flat_on_the_handle():
    centres, normals = (x[0].numpy() for x in pads(torch.tensor([HAND_TOUCH], dtype=torch.float64)))
    side = np.array([1, 1, 1, -1])
    # The handle is a cylinder of 13 mm radius along palm y through the grasp centre.
    assert np.allclose(centres[:, 0] - GRASP_CENTRE[0], side * 0.013, atol=1e-3)
    assert np.allclose(centres[:, 2], GRASP_CENTRE[2], atol=1e-3)
    assert np.allclose(normals[:, 0], -side, atol=1e-3)


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


def test_unknown_task_is_refused_with_the_valid_ones():
    with pytest.raises(DexFlexError, match=r"'Juggle-v0'.*PlaceHammer-v0"):
        make_expert("Juggle-v0")
