"""BrushSweep: bristles that scrape and give way, a pan that keeps its pieces, a success that means swept."""

import mujoco
import numpy as np
import pytest
from env_checks import wait

from lerobot_dexflex.envs import brush_sweep
from lerobot_dexflex.envs.brush_sweep import (
    BRISTLE_END,
    HEAD_CENTRE,
    LIP_DEPTH,
    PAN_DEPTH,
    PIECES_AHEAD,
    PIECES_ALONG,
    SHARE,
    BrushSweepEnv,
)

SEED = 7


@pytest.fixture(scope="module")
def env():
    return BrushSweepEnv(cameras=())


@pytest.fixture
def held(monkeypatch):
    """Every brush counts as held."""
    monkeypatch.setattr(brush_sweep, "pinched", lambda *_: True)


def put_in_pan(env: BrushSweepEnv, n: int) -> None:
    """Lay the first n pieces into the pan in two rows."""
    position, turn = env.pan_pose
    for k in range(n):
        place = (
            0.012 * (k % 6) - 0.03,
            -0.5 * PAN_DEPTH - 0.012 * (k // 6),
            env.episode.piece_radius + 0.001,
        )
        env.data.joint(f"ball{k}").qpos[:3] = position + turn @ place


def stand_free(env: BrushSweepEnv, seed: int, load: float, push: float = 0.0) -> np.ndarray:
    """Press the bristles of an upright brush on the bare table and push them sideways [N].

    Returns the brush's position after 1.6 seconds, from where its bristles touch [m].
    """
    env.reset(seed=seed)
    model, data = env.model, env.data
    body, start = model.body("brush").id, np.array([0.3, -0.4, -BRISTLE_END])
    data.joint("brush").qpos[:] = (*start, *data.joint("brush").qpos[3:])
    weight = model.body_mass[body] * 9.81
    for _ in range(800):
        mujoco.mj_kinematics(model, data)
        rotation = data.xmat[body].reshape(3, 3)
        force = push * rotation[:, 1] - [0, 0, load]
        lever = data.xpos[body] + rotation @ [BRISTLE_END, 0, HEAD_CENTRE] - data.xipos[body]
        data.xfrc_applied[body, :3] = force + np.array([0, 0, weight])
        data.xfrc_applied[body, 3:] = np.cross(lever, force)
        data.joint("brush").qvel[3:] = 0
        mujoco.mj_step(model, data)
    return data.xpos[body] - start


@pytest.mark.parametrize("seed", [0, 3])
def test_bristles_give_way_by_4_mm_per_newton_whatever_the_brush_weighs(env, seed):
    assert -stand_free(env, seed, 1.0)[2] == pytest.approx(0.0044, abs=0.0004)


def test_bristles_scrape_as_their_friction_asks(env):
    env.reset(seed=SEED)
    limit = env.episode.scrape_friction  # At 1 N.
    assert np.linalg.norm(stand_free(env, SEED, 1.0, 0.8 * limit)[:2]) < 0.02
    assert np.linalg.norm(stand_free(env, SEED, 1.0, 1.2 * limit)[:2]) > 0.2


def test_brush_and_pieces_lie_where_the_episode_says_and_stay(env):
    for seed in (0, 1):
        env.reset(seed=seed)
        yaw = env.episode.stand[2] + env.episode.brush_yaw
        wait(env, 15)
        assert np.arccos(env.brush_pose[1][:, 2] @ (np.cos(yaw), np.sin(yaw), 0)) < 0.03
        assert np.allclose(env.brush_pose[0][:2], env.episode.stand[:2], atol=2e-3)
        local, resting = env.pieces_in_pan_frame()
        assert np.allclose(local[:, :2], env.episode.pieces, atol=1e-3)
        assert not resting.any()


def test_pieces_are_scattered_in_front_of_the_pan_apart_from_each_other(env):
    counts = set()
    for seed in range(40):
        pieces = np.array(env._sample_episode(np.random.default_rng(seed)).pieces)
        counts.add(len(pieces))
        assert (np.abs(pieces[:, 0]) < PIECES_ALONG).all()
        assert (pieces[:, 1] > PIECES_AHEAD[0]).all()
        distances = np.linalg.norm(pieces[:, None] - pieces, axis=-1) + np.eye(len(pieces))
        assert distances.min() > 0.012
    assert counts == {8, 9, 10, 11, 12}


def test_the_lip_is_low_and_keeps_what_is_behind_it(env):
    env.reset(seed=SEED)
    position, turn = env.pan_pose
    lip = env.data.geom("pan_lip")
    corners = (
        lip.xpos
        + np.array([[x, y, 1] for x in (-1, 1) for y in (-1, 1)])
        * env.model.geom("pan_lip").size
        @ lip.xmat.reshape(3, 3).T
    )
    assert corners[:, 2].max() == pytest.approx(0.0025, abs=1e-4)
    assert corners[:, 2].min() == pytest.approx(0.0, abs=1e-4)
    piece = env.data.joint("ball0")
    piece.qpos[:3] = position + turn @ (0.0, -LIP_DEPTH - 0.02, env.episode.piece_radius + 0.001)
    piece.qvel[:3] = turn @ (0.0, 0.1, 0.0)
    wait(env, 12)
    local, resting = env.pieces_in_pan_frame()
    assert local[0, 1] < -LIP_DEPTH
    assert resting[0]


def test_enough_pieces_in_the_pan_and_the_brush_held_is_a_success_after_half_a_second(env, held):
    env.reset(seed=SEED)
    n = len(env.episode.pieces)
    put_in_pan(env, int(np.ceil(SHARE * n)))
    info = wait(env, 25)
    assert info["is_success"]
    assert info["progress"] == np.ceil(SHARE * n) / n
    assert env.data.time >= 0.5


def test_one_piece_too_few_or_no_brush_in_the_hand_is_no_success(env, monkeypatch):
    env.reset(seed=SEED)
    n = len(env.episode.pieces)
    put_in_pan(env, n)
    info = wait(env, 20)
    assert info["pieces_in_pan"] == n
    assert not info["is_success"]
    monkeypatch.setattr(brush_sweep, "pinched", lambda *_: True)
    env.reset(seed=SEED)
    put_in_pan(env, int(np.ceil(SHARE * n)) - 1)
    assert not wait(env, 20)["is_success"]


def test_progress_stays_when_pieces_leave_the_pan(env):
    env.reset(seed=SEED)
    n = len(env.episode.pieces)
    put_in_pan(env, 4)
    assert wait(env, 5)["progress"] == pytest.approx(4 / n)
    env.data.joint("ball0").qpos[:3] = (0.3, -0.4, 0.006)
    info = wait(env, 5)
    assert info["pieces_in_pan"] == 3
    assert info["progress"] == pytest.approx(4 / n)


def test_a_brush_on_the_table_is_dropped_unless_it_is_held(env, monkeypatch):
    for pinch in (False, True):
        monkeypatch.setattr(brush_sweep, "pinched", lambda *_, pinch=pinch: pinch)
        env.reset(seed=SEED)
        env.data.joint("brush").qpos[:] = (0.3, -0.4, 0.06, 0.5, 0.5, -0.5, 0.5)
        assert wait(env, 30)["dropped"] == (not pinch)


def test_too_many_pieces_off_the_table_end_the_episode(env):
    env.reset(seed=SEED)
    n = len(env.episode.pieces)
    spare = n - int(np.ceil(SHARE * n))
    for lost in (spare, spare + 1):
        env.reset(seed=SEED)
        for k in range(lost):
            env.data.joint(f"ball{k}").qpos[:3] = (0.3, -0.8 - 0.02 * k, 0.0)
        info = wait(env, 8)
        assert info["dropped"] == (lost > spare)
        assert not info["is_success"]


def test_the_scene_is_that_of_its_episode(env):
    env.reset(seed=SEED)
    episode, model = env.episode, env.model
    assert model.body("brush").mass[0] == pytest.approx(episode.mass)
    assert model.geom("brush_handle").size[1] == episode.handle_half_width
    assert model.geom("if_tip").friction[0] == episode.tip_friction
    assert model.geom("ball0").size[0] == episode.piece_radius
    assert model.body("ball0").mass[0] == pytest.approx(episode.piece_mass)
    assert (model.pair_friction[:, 0] == episode.scrape_friction).all()
    # 60 % of the mass is in the handle, whose centre is the body's origin.
    assert model.body("brush").ipos[2] == pytest.approx(0.4 * HEAD_CENTRE)
