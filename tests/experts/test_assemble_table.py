"""The scripted expert of AssembleTable, and that its recorded fingertips reproduce its episodes."""

import numpy as np
import pytest
import torch

from lerobot_dexflex.envs.assemble_table import AssembleTableEnv
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.assemble_table import GRASP_CENTRE, HAND_TOUCH
from lerobot_dexflex.experts.command import FingertipExecutor
from lerobot_dexflex.hand.kinematics import pads

TASK, SEED = "AssembleTable-v0", 11


def run(seed: int):
    env = AssembleTableEnv(cameras=())
    env.reset(seed=seed)
    commands, info, forces, stages = [], {}, [], []
    for command in make_expert(TASK)(env, np.random.default_rng(seed)):
        commands.append(command)
        *_, done, _, info = env.step(command.executed)
        forces.append(env.pad_forces)
        stages.append(info["progress"])
        if done:
            break
    return env, commands, info, np.array(forces), np.array(stages)


@pytest.fixture(scope="module")
def demonstration():
    return run(SEED)


def test_expert_screws_the_leg_in_well_within_the_time_limit(demonstration):
    env, commands, info, *_ = demonstration
    assert info["is_success"]
    assert info["progress"] == 1
    assert env.lit
    assert len(commands) < 0.9 * TASKS[TASK].max_episode_steps


def test_expert_solves_other_seeds():
    assert all(run(seed)[2]["is_success"] for seed in (21, 22))


def test_expert_holds_the_leg_with_thumb_against_index_and_middle(demonstration):
    *_, forces, stages = demonstration
    held = forces[(stages >= 2 / 6) & (stages < 4 / 6)]
    assert len(held) > 30
    assert (held[:, [0, 1, 3]] > 0.5).all()
    assert not held[:, 2].any()
    assert held[:, 3].mean() == pytest.approx(held[:, :2].sum(1).mean(), rel=0.35)


def test_expert_takes_the_stages_in_order(demonstration):
    stages = demonstration[-1]
    assert (np.diff(stages) >= 0).all()
    assert set(np.round(6 * stages)) == set(range(7))


def test_joint_7_turns_once_without_regrasp(demonstration):
    _, commands, *_ = demonstration
    wrist = np.array([command.joint_targets[6] for command in commands])
    assert 2 * np.pi < np.ptp(wrist) < 3 * np.pi
    assert np.abs(np.diff(wrist)).max() < 0.15  # no jump of a branch


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


def test_touch_posture_puts_three_pads_on_the_leg():
    centres, normals = (x[0].numpy() for x in pads(torch.tensor([HAND_TOUCH], dtype=torch.float64)))
    used = [0, 1, 3]
    offsets = (centres - GRASP_CENTRE)[used]
    # Distance of the leg's axis (palm z through the grasp centre) from the pads' planes: the leg's radius.
    distances = -(offsets * normals[used]).sum(1)
    assert np.allclose(distances, 0.012, atol=1e-3)
    assert np.allclose(offsets[:, 2], 0, atol=1e-3)
    assert normals[3] @ (normals[0] + normals[1]) < -1.9
