"""Disturbances change what they say, nothing else, and can be repeated."""

import gymnasium
import mujoco
import numpy as np
import pytest

from lerobot_dexflex.envs.disturbance import DISTURBANCES, PUSH_INTERVAL, PUSH_STEPS
from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP


def make(task: str, disturbance: str) -> HandEnv:
    env = gymnasium.make(
        f"lerobot_dexflex/{task}", cameras=(), disturbance=disturbance, disable_env_checker=True
    )
    env.reset(seed=3)
    assert isinstance(env.unwrapped, HandEnv)
    return env.unwrapped


@pytest.mark.parametrize("task", TASKS)
def test_the_scene_is_the_same_but_for_what_is_disturbed(task):
    calm, heavy, slippery = (make(task, name) for name in ("none", "heavy", "slippery"))
    assert calm.episode == heavy.episode == slippery.episode
    held = calm.model.body(calm.manipulated).id
    assert heavy.model.body_mass[held] == pytest.approx(1.5 * calm.model.body_mass[held])
    assert np.delete(heavy.model.body_mass, held) == pytest.approx(np.delete(calm.model.body_mass, held))
    tip = calm.model.geom("th_tip").id
    assert slippery.model.geom_friction[tip, 0] == pytest.approx(0.6 * calm.model.geom_friction[tip, 0])
    assert np.array_equal(slippery.model.body_mass, calm.model.body_mass)


def test_a_pushed_object_feels_its_weight_for_a_moment_and_a_snapshot_repeats_it():
    env = make("PlaceHammer-v0", "pushed")
    held, hold = env.model.body("hammer").id, env.command
    weight = 9.81 * env.model.body_mass[held]
    env.advance(hold)
    snapshot = env.snapshot()

    def run() -> list[np.ndarray]:
        forces = []
        for _ in range(2 * PUSH_INTERVAL - 1):
            env.advance(hold)
            forces.append(env.data.xfrc_applied[held, :3].copy())
        return forces

    first = run()
    size = np.linalg.norm(first, axis=1)
    assert (size > 0).sum() in range(PUSH_STEPS, 2 * PUSH_STEPS + 1)
    np.testing.assert_allclose(size[size > 0], weight, rtol=1e-3)
    env.restore(snapshot)
    assert np.array_equal(run(), first)


def test_late_touch_is_late():
    calm, late = make("Reach-v0", "none"), make("Reach-v0", "late_touch")
    readings = []
    for env in (calm, late):
        seen = []
        for k in range(8):
            env.advance(env.command + 0.02 * k)
            seen.append(env.observe()["tactile"].sum())
        readings.append(seen)
    np.testing.assert_allclose(readings[1][DISTURBANCES["late_touch"].latency :], readings[0][:-3], rtol=0.2)


@pytest.mark.parametrize("task", ["Reach-v0", "PlaceHammer-v0"])
def test_a_miscalibrated_hand_is_not_where_its_encoders_say_and_a_snapshot_repeats_it(task):
    calm, off = make(task, "none"), make(task, "miscalibrated")
    assert off.episode == calm.episode
    errors = off.memory["encoder_errors"]
    assert (np.ptp(errors) > 0.02, np.abs(errors).max() <= 0.05) == (True, True)
    seen, true = off.observe(), off.data.site_xpos.copy()
    # Its encoders and its fingertips are those of the calm hand; the fingertips really are millimetres away.
    for key in ("agent_pos", "fingertips"):
        np.testing.assert_allclose(seen[key], calm.observe()[key], atol=1e-6)
    tips = [calm.model.site(f"{finger}_tip").id for finger in LEAP.prefixes]
    distance = np.linalg.norm(true[tips] - calm.data.site_xpos[tips], axis=1)
    assert ((distance > 0.0005) & (distance < 0.012)).all()
    # A hand whose encoders are right reaches the same pose at angles that are smaller by the errors.
    address = [calm.model.joint(joint).qposadr[0] for joint in LEAP.joint_names]
    calm.data.qpos[address] -= errors
    mujoco.mj_forward(calm.model, calm.data)
    np.testing.assert_allclose(calm.data.site_xpos[tips], true[tips], atol=1e-9)

    snapshot = off.snapshot()
    other = make(task, "miscalibrated")
    other.reset(seed=4)
    assert not np.array_equal(other.memory["encoder_errors"], errors)
    other.restore(snapshot)
    for env in (off, other):
        env.advance(env.command + 0.01)
    assert np.array_equal(off.data.qpos, other.data.qpos)


def test_an_unknown_disturbance_is_refused():
    with pytest.raises(DexFlexError, match="Valid: none, heavy"):
        make("Reach-v0", "windy")
