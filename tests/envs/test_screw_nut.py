"""The nut that rests askew, the thread that catches it, and a success that needs strokes and a hold."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.envs import screw_nut
from lerobot_dexflex.envs.nut_and_bolt import DOME_HEIGHT, PITCH, RIM, TURNS
from lerobot_dexflex.envs.screw_nut import CATCH_DISTANCE, CATCH_TILT, TIGHT, TILT, ScrewNutEnv

SEED = 7


@pytest.fixture(scope="module")
def env():
    return ScrewNutEnv(cameras=())


@pytest.fixture
def held(monkeypatch):
    """Whether the hand is to count as holding the nut, from the next judgement on."""
    held = {"nut": False}
    monkeypatch.setattr(screw_nut, "pinched", lambda *_: held["nut"])
    return held


def set_on_bolt(env: ScrewNutEnv, offset=(0.0, 0.0, 0.0), tilt=0.0) -> dict:
    """Put the nut onto the dome, the hand where it starts, and judge that."""
    env.reset(seed=SEED)
    pose = env.data.joint("nut").qpos
    pose[:3] = env.goal_position + np.array(offset)
    mujoco.mju_axisAngle2Quat(pose[3:7], np.array([1.0, 0.0, 0.0]), tilt)
    mujoco.mj_forward(env.model, env.data)
    return env._update()


def twist(env: ScrewNutEnv, torque: float, steps: int, pull: float = 0.0) -> dict:
    """Turn the nut (N m, clockwise from above is positive) and pull at it (N)."""
    info = {}
    for _ in range(steps):
        env.data.body("nut").xfrc_applied[:] = (0, 0, pull, 0, 0, -torque)
        *_, done, _, info = env.step(env.command)
        if done:
            break
    env.data.body("nut").xfrc_applied[:] = 0
    return info


def turn_to(env: ScrewNutEnv, turns: float) -> dict:
    """Turn the nut so far."""
    info = {}
    while env.turns < turns and env.data.time < 10:
        info = twist(env, 2 * env.episode.thread_friction, 1)
    assert env.turns >= turns
    return info


def test_the_nut_rests_askew_and_nothing_is_achieved(env):
    for seed in range(4):
        _, info = env.reset(seed=seed)
        assert info["is_success"] is False
        assert info["progress"] == 0
        for _ in range(20):
            *_, info = env.step(env.command)
        position, rotation = env.nut_pose
        assert np.linalg.norm(position - env.goal_position) < 0.001
        assert np.arccos(rotation[2, 2]) == pytest.approx(env.episode.tilt[0], abs=0.02)
        assert not env.caught
        assert not info["dropped"]


def test_the_nut_has_the_mass_and_size_of_its_episode(env):
    env.reset(seed=SEED)
    episode = env.episode
    assert env.model.body("nut").subtreemass[0] == pytest.approx(episode.mass)
    assert np.allclose(env.model.geom("nut").size[:2], (episode.nut_radius, episode.nut_height / 2))
    assert env.model.geom("if_tip").friction[0] == episode.tip_friction
    assert env.model.dof_frictionloss[env.model.joint("thread_turn").dofadr[0]] == episode.thread_friction


def test_the_nut_tilts_every_way_as_far_as_documented(env):
    tilts = np.array([env._sample_episode(np.random.default_rng(seed)).tilt for seed in range(300)])
    assert TILT == (0.12, 0.25)
    assert 0.12 < tilts[:, 0].min() < 0.13 < 0.24 < tilts[:, 0].max() < 0.25
    assert np.ptp(tilts[:, 1]) > 6.0
    assert TILT[0] > CATCH_TILT


def test_the_thread_catches_only_a_nut_that_is_straight_on_the_bolt(env):
    caught = []
    for offset, tilt in (
        ((0, 0, 0), 0),
        ((0, 0, 0.9 * CATCH_DISTANCE), 0),
        ((0, 0, 1.1 * CATCH_DISTANCE), 0),
        ((1.1 * CATCH_DISTANCE, 0, 0), 0),
        ((0, 0, 0), 0.9 * CATCH_TILT),
        ((0, 0, 0), 1.1 * CATCH_TILT),
    ):
        set_on_bolt(env, offset, tilt)
        caught.append(env.caught)
    assert caught == [True, True, False, False, True, False]


def test_a_turned_nut_sinks_by_its_pitch_and_stops_when_tight(env):
    set_on_bolt(env)
    twist(env, 0.0, 2)
    height = env.nut_pose[0][2]
    while not env.tight and env.data.time < 5:
        twist(env, 2 * env.episode.thread_friction, 1)
        assert height - env.nut_pose[0][2] == pytest.approx(PITCH * env.turns, abs=2e-4)
    assert env.tight
    twist(env, 2 * env.episode.thread_friction, 20)
    assert TURNS - TIGHT < env.turns < TURNS + 0.02


def test_the_thread_needs_torque_and_holds_against_a_pull(env):
    set_on_bolt(env)
    twist(env, 0.7 * env.episode.thread_friction, 20)
    assert env.turns < 0.01
    twist(env, 0.0, 10, pull=10.0)
    assert np.linalg.norm(env.nut_pose[0] - env.goal_position) < 0.001
    set_on_bolt(env, tilt=0.2)
    twist(env, 0.0, 10, pull=1.0)
    assert env.nut_pose[0][2] > DOME_HEIGHT + RIM


def test_the_bolt_counts_as_a_contact_of_the_nut_on_its_thread(env):
    assert not set_on_bolt(env, offset=(0, 0, 0.02))["contacts"].any()
    assert set_on_bolt(env)["contacts"].tolist() == [False] * 4 + [True]


def test_a_nut_turned_tight_by_two_strokes_is_a_success_after_half_a_second_of_hold(env, held):
    set_on_bolt(env)
    for goal in (0.25, TURNS - TIGHT):
        held["nut"] = True
        info = turn_to(env, goal)
        held["nut"] = False
        info = twist(env, 0.0, 15)
    assert env.tight
    assert not info["is_success"]
    assert info["progress"] == pytest.approx(5 / 6)
    held["nut"] = True
    start = env.data.time
    info = twist(env, 0.0, 30)
    assert info["is_success"]
    assert info["progress"] == 1
    assert env.data.time - start == pytest.approx(0.5, abs=0.01)


def test_one_stroke_is_not_enough_as_when_the_wrist_turns_the_nut(env, held):
    set_on_bolt(env)
    twist(env, 0.0, 2)
    held["nut"] = True
    turn_to(env, TURNS - TIGHT)
    assert not twist(env, 0.0, 30)["is_success"]


def test_a_nut_that_is_not_tight_is_no_success(env, held):
    set_on_bolt(env)
    for goal in (0.15, 0.3):
        held["nut"] = False
        twist(env, 0.0, 2)
        held["nut"] = True
        turn_to(env, goal)
    info = twist(env, 0.0, 15)
    assert not info["is_success"]
    assert 2 / 6 < info["progress"] < 5 / 6


def test_progress_does_not_fall_when_the_nut_is_turned_back(env):
    set_on_bolt(env)
    info = turn_to(env, 0.2)
    reached = info["progress"]
    info = twist(env, -2 * env.episode.thread_friction, 6)
    assert env.turns < 0.18
    assert info["progress"] >= reached


@pytest.mark.parametrize("beside", [0.025, 0.2])
def test_a_nut_on_block_or_table_is_dropped(env, beside):
    info = set_on_bolt(env, offset=(beside, 0, 0))
    assert not info["dropped"]
    info = twist(env, 0.0, 20)
    assert info["dropped"]
    assert not info["is_success"]
