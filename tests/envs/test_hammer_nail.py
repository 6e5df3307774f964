"""HammerNail: a nail that momentum drives, and a success that means the hammer is still held."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.envs import hammer_nail
from lerobot_dexflex.envs.hammer import HEAD_CENTRE, HEAD_HALF_SIZE
from lerobot_dexflex.envs.hammer_nail import NAIL_DEPTH, TOLERANCE, HammerNailEnv

SEED = 7
PINCH = {"th_ds", "if_ds"}


@pytest.fixture(scope="module")
def env():
    return HammerNailEnv(cameras=())


def push_nail(env: HammerNailEnv, share: float) -> float:
    """Push on the nail with a share of its friction for a second; return its depth [m]."""
    env.reset(seed=SEED)
    env.data.xfrc_applied[env.model.body("nail").id, 2] = -share * env.episode.nail_friction
    mujoco.mj_step(env.model, env.data, 500)
    return env.nail_depth


def let_fall(env: HammerNailEnv, height: float) -> float:
    """Let the hammer fall on the nail from a height [m], level and balanced; return the nail's depth [m]."""
    env.reset(seed=SEED)
    centre = env.model.body("hammer").ipos[2]
    rotation = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    pose = env.data.joint("hammer").qpos
    pose[:3] = np.add(env.nail_top, (-centre, 0.0, height + env.episode.handle_radius))
    mujoco.mju_mat2Quat(pose[3:7], rotation.ravel())
    mujoco.mj_step(env.model, env.data, 100)
    return env.nail_depth


def judge(env: HammerNailEnv, monkeypatch, depth: float, touching: set[str], steps: int) -> dict:
    """Put the nail to a depth [m] and judge it for some steps as if these touched the hammer."""
    env.reset(seed=SEED)
    monkeypatch.setattr(hammer_nail, "contact_names", lambda *_: touching)
    env.data.joint("nail").qpos[:] = depth
    return [env.step(env.command)[-1] for _ in range(steps)][-1]


def test_friction_holds_the_nail_against_less_and_gives_way_to_more(env):
    assert push_nail(env, 0.9) < 0.001
    assert push_nail(env, 1.2) > NAIL_DEPTH - 0.001


def test_a_falling_hammer_drives_the_nail_by_no_more_than_its_energy(env):
    low, high = let_fall(env, 0.04), let_fall(env, 0.08)
    weight = env.episode.mass * 9.81
    for height, depth in ((0.04, low), (0.08, high)):
        assert 0.3 * weight * height < depth * env.episode.nail_friction < weight * (height + depth)
    assert high > 1.4 * low


def test_a_nail_that_is_in_is_a_success_once_the_hammer_was_held_for_half_a_second(env, monkeypatch):
    in_deep = NAIL_DEPTH - 0.9 * TOLERANCE
    assert not judge(env, monkeypatch, in_deep, PINCH, 8)["is_success"]
    info = judge(env, monkeypatch, in_deep, PINCH, 10)
    assert info["is_success"]
    assert info["progress"] == 1


@pytest.mark.parametrize("touching", [set(), {"th_ds"}, {"if_ds", "mf_ds"}, {*PINCH, "palm_c3"}])
def test_a_hammer_that_is_not_held_or_jammed_against_the_palm_is_no_success(env, monkeypatch, touching):
    assert not judge(env, monkeypatch, NAIL_DEPTH, touching, 15)["is_success"]


def test_a_nail_that_stands_out_is_no_success(env, monkeypatch):
    info = judge(env, monkeypatch, NAIL_DEPTH - 1.2 * TOLERANCE, PINCH, 15)
    assert not info["is_success"]
    assert 0.95 < info["progress"] < 1


def test_progress_is_the_greatest_depth_so_far(env):
    env.reset(seed=SEED)
    for depth, share in ((0.007, 0.25), (0.014, 0.5), (0.007, 0.5)):
        env.data.joint("nail").qpos[:] = depth
        *_, info = env.step(env.command)
        assert info["progress"] == pytest.approx(share, abs=0.01)


def test_a_hammer_on_the_table_is_dropped(env):
    env.reset(seed=SEED)
    env.data.joint("hammer").qpos[:3] = (0.5, 0.3, 0.06)
    infos = [env.step(env.command)[-1] for _ in range(10)]
    assert infos[-1]["dropped"]


def test_the_hammer_lies_with_its_face_down_and_stays(env):
    for seed in range(3):
        env.reset(seed=seed)
        assert env.model.body("hammer").mass[0] == pytest.approx(env.episode.mass)
        position, rotation = env.hammer_pose
        assert np.allclose(rotation[:, 1], (0, 0, 1), atol=1e-6)
        infos = [env.step(env.command)[-1] for _ in range(20)]
        assert not infos[-1]["dropped"]
        assert env.hammer_pose[1][2, 1] > np.cos(0.03)
        assert np.linalg.norm(env.hammer_pose[0] - position) < 0.002
        assert env.nail_depth < 1e-4


def test_the_hammer_in_its_cradle_is_clear_of_the_table(env):
    env.reset(seed=SEED)
    position, rotation = env.hammer_pose
    face = position + rotation @ np.array([0.0, -HEAD_HALF_SIZE[1], HEAD_CENTRE])
    assert face[2] > 0.005
