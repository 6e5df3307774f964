"""PlaceHammer: the hammer of the episode, and a success that means hanging."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.envs.hammer import HEAD_CENTRE
from lerobot_dexflex.envs.place_hammer import PlaceHammerEnv

SEED = 7


@pytest.fixture(scope="module")
def env():
    return PlaceHammerEnv(cameras=())


def hang(env: PlaceHammerEnv, offset=(0.0, 0.0, 0.0)) -> dict:
    """Put the hammer upright into the holder, the hand far away, and let it settle."""
    env.reset(seed=SEED)
    pose = env.data.joint("hammer").qpos
    pose[:3] = env.goal_position + offset
    mujoco.mju_mat2Quat(pose[3:7], np.array([[-1.0, 0, 0], [0, -1.0, 0], [0, 0, 1.0]]).ravel())
    env.memory.clear()
    info = {}
    for _ in range(25):
        *_, info = env.step(env.command)
        if info["is_success"] or info["dropped"]:
            break
    return info


def test_a_hanging_hammer_is_a_success_after_half_a_second(env):
    assert hang(env)["is_success"]
    assert env.data.time >= 0.5


def test_a_hammer_beside_the_prongs_drops_and_fails(env):
    info = hang(env, offset=(0.0, 0.075, 0.0))
    assert not info["is_success"]
    assert info["dropped"]


def test_the_hammer_has_the_mass_and_size_of_its_episode(env):
    env.reset(seed=SEED)
    assert env.model.body("hammer").mass[0] == pytest.approx(env.episode.mass)
    assert env.model.geom("hammer_handle").size[0] == env.episode.handle_radius
    assert env.model.geom("hammer_head").pos[2] == HEAD_CENTRE
    assert env.model.geom("if_tip").friction[0] == env.episode.tip_friction


def test_most_of_the_mass_is_in_the_handle(env):
    env.reset(seed=SEED)
    # The handle's centre is the body's origin: 40 % of the mass is at the head.
    assert env.model.body("hammer").ipos[2] == pytest.approx(0.4 * HEAD_CENTRE)


def test_the_hammer_lies_level_along_its_turned_cradle_and_stays(env):
    for seed in range(4):
        env.reset(seed=seed)
        yaw = env.episode.cradle[2] + env.episode.hammer_yaw
        assert np.allclose(env.hammer_pose[1][:, 2], (np.cos(yaw), np.sin(yaw), 0), atol=1e-6)
        for _ in range(20):
            env.step(env.command)
        assert np.arccos(env.hammer_pose[1][:, 2] @ (np.cos(yaw), np.sin(yaw), 0)) < 0.05


def test_cradles_are_turned_by_up_to_two_fifths_of_a_radian(env):
    yaws = [env._sample_episode(np.random.default_rng(seed)).cradle[2] for seed in range(300)]
    assert -0.4 < min(yaws) < -0.37
    assert 0.37 < max(yaws) < 0.4
