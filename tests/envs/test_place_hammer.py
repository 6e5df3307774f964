"""The environment every later result rests on: determinism, contracts, honest success."""

import gymnasium
import mujoco
import numpy as np
import pytest
from env_checks import same, wiggle
from gymnasium.utils.env_checker import check_env

from lerobot_dexflex.envs.hand_env import HandEnv
from lerobot_dexflex.envs.place_hammer import HEAD_CENTRE, PlaceHammerEnv
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.touch import TouchConfig

SEED = 7


@pytest.fixture(scope="module")
def env():
    return PlaceHammerEnv(cameras=())


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_gymnasium_accepts_the_environment():
    env = gymnasium.make("lerobot_dexflex/PlaceHammer-v0")
    check_env(env.unwrapped)
    assert env.spec is not None
    assert env.spec.max_episode_steps == 300


def test_observation_has_the_documented_shapes_and_names():
    env = PlaceHammerEnv()
    observation, info = env.reset(seed=SEED)
    assert observation["pixels"]["front"].shape == observation["pixels"]["wrist"].shape == (96, 96, 3)
    shapes = {key: value.shape for key, value in observation.items() if key != "pixels"}
    assert shapes == {"agent_pos": (23,), "tactile": (240,), "fingertips": (12,), "gravity": (3,)}
    assert info["is_success"] is False
    assert info["progress"] == 0
    # The palm starts facing down: gravity points out of the palm, along its -z axis.
    assert observation["gravity"] @ np.array([0, 0, -1]) > 0.99


def test_the_same_seed_gives_the_same_episode(env):
    first, _ = env.reset(seed=SEED)
    first_run = wiggle(env, 5)
    second, _ = env.reset(seed=SEED)
    assert same(first, second)
    assert all(same(a[0], b[0]) for a, b in zip(first_run, wiggle(env, 5), strict=True))
    other, _ = env.reset(seed=SEED + 1)
    assert not same(first["agent_pos"], other["agent_pos"])


def test_restored_snapshot_replays_bit_for_bit_also_in_another_environment(env):
    env.reset(seed=SEED)
    wiggle(env, 3)
    snapshot = env.snapshot()
    expected = wiggle(env, 8, seed=1)
    env.reset(seed=SEED + 1)
    env.restore(snapshot)
    assert all(same(a[0], b[0]) for a, b in zip(expected, wiggle(env, 8, seed=1), strict=True))
    other = PlaceHammerEnv(cameras=())
    other.reset(seed=3)
    other.restore(snapshot)
    assert all(same(a[0], b[0]) for a, b in zip(expected, wiggle(other, 8, seed=1), strict=True))


def test_restored_snapshot_replays_touch_noise_and_latency():
    env = PlaceHammerEnv(cameras=(), touch=TouchConfig(latency_steps=2))
    env.reset(seed=SEED)
    wiggle(env, 4)
    snapshot = env.snapshot()
    expected = [step[0]["tactile"] for step in wiggle(env, 5)]
    env.restore(snapshot)
    assert same(dict(enumerate(expected)), dict(enumerate(step[0]["tactile"] for step in wiggle(env, 5))))


@pytest.mark.parametrize("action", [np.zeros(16), np.zeros((1, 23)), np.full(23, np.nan), [np.inf] * 23])
def test_bad_action_is_refused_and_nothing_is_executed(env, action):
    env.reset(seed=SEED)
    before = env.data.qpos.copy()
    with pytest.raises(DexFlexError, match=r"shape \(23,\)|NaN or infinity"):
        env.step(np.asarray(action))
    assert np.array_equal(before, env.data.qpos)


def test_targets_outside_the_limits_are_clipped(env):
    env.reset(seed=SEED)
    env.step(np.full(23, 100.0))
    assert np.allclose(env.command, env.action_space.high, atol=1e-6)


def test_unknown_camera_is_named_with_the_valid_ones():
    with pytest.raises(DexFlexError, match=r"\['side'\].*front"):
        PlaceHammerEnv(cameras=("side",))


def test_targets_are_interpolated_within_the_control_step(env):
    env.reset(seed=SEED)
    start = env.command
    target = start + 0.1 * np.eye(23)[0]
    env.step(target)
    assert env.data.ctrl[0] == pytest.approx(target[0])
    # A ramp of 50 ms on a servo with 0.1 s of lag moves it, but far less than a step to the target would.
    assert 0 < env.data.qpos[0] - start[0] < 0.05


def test_doing_nothing_and_acting_at_random_never_succeed(env):
    for seed in range(3):
        env.reset(seed=seed)
        start, rng = env.command, np.random.default_rng(seed)
        for step in range(60):
            action = (
                start
                if seed
                else env.action_space.low
                + rng.random(23) * np.ptp([env.action_space.low, env.action_space.high], axis=0)
            )
            *_, info = env.step(action)
            assert not info["is_success"], step
            assert info["progress"] < 0.6


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


@pytest.mark.parametrize("task", TASKS)
def test_every_task_gives_the_fingers_the_configured_skin(task):
    def height(skin: float) -> float:
        config = TouchConfig(skin=skin)
        env = gymnasium.make(f"lerobot_dexflex/{task}", cameras=(), touch=config).unwrapped
        assert isinstance(env, HandEnv)
        env.reset(seed=SEED)
        # The outward pad normal is -x of the distal link.
        return -env.model.geom("if_skin").pos[0]

    assert height(0.003) - height(0.0015) == pytest.approx(0.0015, abs=1e-9)
