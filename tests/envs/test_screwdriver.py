"""The screw that only a pressed bit turns, the driver that stands in it, and a success that needs both."""

import mujoco
import numpy as np
import pytest

from lerobot_dexflex.envs import screwdriver
from lerobot_dexflex.envs.driver_and_screw import BIT_LENGTH, BITE, PITCH, SCREW_FRICTION, TURNS
from lerobot_dexflex.envs.screwdriver import LEAN, SEATED_TILT, TIGHT, ScrewdriverEnv

SEED = 7


@pytest.fixture(scope="module")
def env():
    return ScrewdriverEnv(cameras=())


def stand_in_screw(env: ScrewdriverEnv, offset=(0.0, 0.0, 0.0), tilt=0.0) -> dict:
    """Put the tip of the bit onto the recess's floor, the hand where it starts, and judge that."""
    env.reset(seed=SEED)
    lean = np.zeros(4)
    mujoco.mju_axisAngle2Quat(lean, np.array([1.0, 0.0, 0.0]), tilt)
    pose = env.data.joint("driver").qpos
    tip = env.goal_position - (0, 0, BIT_LENGTH) + np.array(offset)
    pose[:3] = tip + BIT_LENGTH * np.array([0, -np.sin(tilt), np.cos(tilt)])
    pose[3:7] = lean
    mujoco.mj_forward(env.model, env.data)
    return env._update()


def twist(env: ScrewdriverEnv, torque: float, press: float, steps: int) -> dict:
    """Turn the driver (N m, clockwise from above is positive) and press it down (N)."""
    info = {}
    for _ in range(steps):
        env.data.body("driver").xfrc_applied[:] = (0, 0, -press, 0, 0, -torque)
        *_, done, _, info = env.step(env.command)
        if done:
            break
    env.data.body("driver").xfrc_applied[:] = 0
    return info


def tighten(env: ScrewdriverEnv) -> dict:
    """Turn the screw until it is tight."""
    stand_in_screw(env)
    info = {}
    while not env.tight and env.data.time < 5:
        info = twist(env, 1.5 * SCREW_FRICTION, 3.0, 1)
    return info


def test_the_driver_starts_leaning_in_its_stand_stays_there_and_nothing_is_achieved(env):
    for seed in range(4):
        _, info = env.reset(seed=seed)
        assert info["is_success"] is False
        assert info["progress"] == 0
        start, _ = env.driver_pose
        for _ in range(20):
            *_, info = env.step(env.command)
        position, rotation = env.driver_pose
        assert np.linalg.norm(position - start) < 0.004
        assert np.arccos(rotation[2, 2]) == pytest.approx(abs(env.episode.lean), abs=0.05)
        assert not info["dropped"]


def test_the_driver_has_the_mass_and_radius_of_its_episode(env):
    env.reset(seed=SEED)
    assert env.model.body("driver").mass[0] == pytest.approx(env.episode.mass)
    assert env.model.geom("driver_handle").size[0] == env.episode.handle_radius
    assert env.model.geom("if_tip").friction[0] == env.episode.tip_friction


def test_the_stand_leans_either_way_as_far_as_documented(env):
    leans = [env._sample_episode(np.random.default_rng(seed)).lean for seed in range(300)]
    assert LEAN == (-0.25, 0.25)
    assert -0.25 < min(leans) < -0.23
    assert 0.23 < max(leans) < 0.25


def test_a_bit_is_seated_within_two_millimetres_and_ten_degrees(env):
    seated = []
    for offset, tilt in (
        ((0, 0, 0), 0),
        ((0, 0, 0.0015), 0),
        ((0, 0, 0.003), 0),
        ((0.003, 0, 0), 0),
        ((0, 0, 0), 0.9 * SEATED_TILT),
        ((0, 0, 0), 1.1 * SEATED_TILT),
    ):
        stand_in_screw(env, offset, tilt)
        seated.append(env.seated)
    assert seated == [True, True, False, False, True, False]


def test_a_driver_left_alone_stands_in_the_screw(env):
    stand_in_screw(env)
    env.data.joint("driver").qvel[3] = 0.5
    info = twist(env, 0.0, 0.0, 30)
    assert env.seated
    assert env.turns < 0.005
    assert not info["dropped"]
    assert not info["is_success"]
    assert info["progress"] == pytest.approx(3 / 6, abs=0.005)


def test_a_pressed_bit_turns_the_screw_which_sinks_by_its_pitch_and_stops_when_tight(env):
    stand_in_screw(env)
    height = env.data.body("screw").xpos[2]
    while not env.tight and env.data.time < 5:
        twist(env, 1.5 * SCREW_FRICTION, 3.0, 1)
        assert height - env.data.body("screw").xpos[2] == pytest.approx(PITCH * env.turns, abs=2e-4)
    assert env.tight
    twist(env, 1.5 * SCREW_FRICTION, 3.0, 20)
    assert TURNS - TIGHT < env.turns < TURNS + 0.02


def test_the_screw_needs_torque(env):
    stand_in_screw(env)
    twist(env, 0.7 * SCREW_FRICTION, 3.0, 20)
    assert env.turns < 0.01


def test_a_pressed_bit_turns_with_the_screw_and_one_that_is_not_pressed_slips(env):
    slipped = []
    for press in (3.0, 0.0):
        stand_in_screw(env)
        twist(env, 1.5 * SCREW_FRICTION, press, 2)
        _, rotation = env.driver_pose
        slipped.append(-np.arctan2(rotation[1, 0], rotation[0, 0]) - 2 * np.pi * env.turns)
    assert BITE * 9.81 * env.episode.mass < SCREW_FRICTION
    assert abs(slipped[0]) < 0.05
    assert slipped[1] > 0.5


def test_a_lifted_bit_lets_go_of_the_screw(env):
    stand_in_screw(env)
    twist(env, 1.5 * SCREW_FRICTION, 3.0, 4)
    twist(env, 0.0, 0.0, 4)
    turned = env.turns
    assert turned > 0.02
    twist(env, 0.0, -2.0, 4)
    assert not env.seated
    twist(env, 1.5 * SCREW_FRICTION, -0.6, 4)
    assert env.turns == pytest.approx(turned, abs=0.005)


def test_a_tight_screw_is_a_success_after_half_a_second_and_only_with_the_driver_in_the_hand(
    env, monkeypatch
):
    info = tighten(env)
    info = twist(env, 0.0, 0.0, 15)
    assert env.tight
    assert not info["is_success"]
    assert info["progress"] == pytest.approx(5 / 6)
    monkeypatch.setattr(screwdriver, "pinched", lambda *_: True)
    start = env.data.time
    info = twist(env, 0.0, 0.0, 30)
    assert info["is_success"]
    assert info["progress"] == 1
    assert env.data.time - start == pytest.approx(0.5, abs=0.01)


def test_a_loose_screw_is_no_success_with_the_driver_in_the_hand(env, monkeypatch):
    monkeypatch.setattr(screwdriver, "pinched", lambda *_: True)
    stand_in_screw(env)
    twist(env, 1.5 * SCREW_FRICTION, 3.0, 4)
    info = twist(env, 0.0, 0.0, 15)
    assert not info["is_success"]
    assert 3 / 6 < info["progress"] < 5 / 6


def test_progress_does_not_fall_when_the_screw_is_turned_back(env):
    stand_in_screw(env)
    info = twist(env, 1.5 * SCREW_FRICTION, 3.0, 6)
    turned, reached = env.turns, info["progress"]
    info = twist(env, -1.5 * SCREW_FRICTION, 3.0, 6)
    assert env.turns < turned - 0.02
    assert info["progress"] >= reached


def test_a_driver_on_the_table_is_dropped(env):
    env.reset(seed=SEED)
    env.data.joint("driver").qpos[:3] = (0.3, 0.3, BIT_LENGTH + 0.01)
    info = {"dropped": False}
    for _ in range(20):
        *_, info = env.step(env.command)
        if info["dropped"]:
            break
    assert info["dropped"]
    assert not info["is_success"]
