"""Disturbances change what they say, nothing else, and can be repeated."""

import gymnasium
import numpy as np
import pytest

from lerobot_dexflex.envs.disturbance import DISTURBANCES, PUSH_INTERVAL, PUSH_STEPS
from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError


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


def test_an_unknown_disturbance_is_refused():
    with pytest.raises(DexFlexError, match="Valid: none, heavy"):
        make("Reach-v0", "windy")
