"""PlaceHammer: the hammer of the episode, and a success that means hanging."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.envs.place_hammer import HEAD_CENTRE, PlaceHammerEnv

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
