"""What every task promises: determinism, contracts, no success by accident."""

import gymnasium
import numpy as np
import pytest
from env_checks import make_env, same, wiggle
from gymnasium.utils.env_checker import check_env

from lerobot_dexflex.envs.place_hammer import PlaceHammerEnv
from lerobot_dexflex.envs.registration import TASKS
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.touch import TouchConfig
from lerobot_dexflex.hands import LEAP

SEED = 7
MAX_STEPS = {
    "AssembleTable-v0": 500,
    "BrushSweep-v0": 400,
    "FlipToast-v0": 500,
    "HammerNail-v0": 400,
    "PlaceHammer-v0": 300,
    "PourCup-v0": 400,
    "Reach-v0": 200,
    "ScrewNut-v0": 500,
    "Screwdriver-v0": 500,
    "SpatulaServe-v0": 400,
}


@pytest.fixture(scope="module", params=TASKS)
def any_env(request):
    return make_env(request.param, cameras=())


@pytest.fixture(scope="module")
def env():
    return PlaceHammerEnv(cameras=())


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_gymnasium_accepts_the_environment(task):
    env = gymnasium.make(f"lerobot_dexflex/{task}")
    check_env(env.unwrapped)
    assert env.spec is not None
    assert env.spec.max_episode_steps == MAX_STEPS[task]


def test_the_same_seed_gives_the_same_episode_and_another_one_another(any_env):
    first = [any_env.reset(seed=SEED), wiggle(any_env, 5)]
    episode = any_env.episode
    other = make_env(any_env.task, cameras=())
    observation, _ = other.reset(seed=SEED + 1)
    assert other.episode != episode
    assert not same(observation["agent_pos"], first[0][0]["agent_pos"])
    for env in (any_env, other):
        assert same([env.reset(seed=SEED), wiggle(env, 5)], first)
        assert env.episode == episode


RANGES = {
    "AssembleTable-v0": {"mass": (0.03, 0.07), "leg_radius": (0.0115, 0.015), "tip_friction": (0.8, 1.2)},
    "BrushSweep-v0": {"mass": (0.05, 0.10), "handle_half_width": (0.009, 0.014), "tip_friction": (0.8, 1.2)},
    "FlipToast-v0": {
        "mass": (0.04, 0.06),
        "slice_mass": (0.025, 0.04),
        "handle_half_width": (0.009, 0.014),
        "tip_friction": (0.8, 1.2),
        "blade_friction": (0.2, 0.3),
    },
    "HammerNail-v0": {"mass": (0.09, 0.16), "nail_friction": (5.0, 8.0), "tip_friction": (0.8, 1.2)},
    "PlaceHammer-v0": {"mass": (0.06, 0.16), "handle_radius": (0.010, 0.015), "tip_friction": (0.8, 1.2)},
    "PourCup-v0": {"mass": (0.05, 0.10), "handle_half_width": (0.008, 0.013), "tip_friction": (0.8, 1.2)},
    "ScrewNut-v0": {
        "mass": (0.02, 0.05),
        "nut_radius": (0.014, 0.018),
        "nut_height": (0.020, 0.028),
        "thread_friction": (0.01, 0.03),
        "tip_friction": (0.8, 1.2),
    },
    "Screwdriver-v0": {"mass": (0.04, 0.08), "handle_radius": (0.011, 0.014), "tip_friction": (0.8, 1.2)},
    "SpatulaServe-v0": {
        "mass": (0.04, 0.06),
        "patty_mass": (0.03, 0.045),
        "handle_half_width": (0.009, 0.014),
        "tip_friction": (0.8, 1.2),
        "blade_friction": (0.2, 0.3),
    },
}
"""What docs/tasks.md says of masses [kg], sizes [m] and friction."""


@pytest.mark.parametrize("task", RANGES)
def test_episodes_cover_the_documented_ranges(task):
    env = make_env(task, cameras=())
    episodes = [env._sample_episode(np.random.default_rng(seed)) for seed in range(300)]
    for name, (low, high) in RANGES[task].items():
        drawn = np.array([getattr(episode, name) for episode in episodes])
        margin = 0.05 * (high - low)
        assert low <= drawn.min() < low + margin, name
        assert high - margin < drawn.max() <= high, name


@pytest.mark.parametrize("task", RANGES)
def test_tasks_with_a_tool_start_with_a_relaxed_hand_that_touches_nothing(task):
    env = make_env(task, cameras=())
    observation, info = env.reset(seed=SEED)
    assert np.array_equal(env.command[7:], LEAP.relaxed_joints)
    # PourCup settles its balls first; fingers sag by less than 3 degrees meanwhile.
    assert np.allclose(observation["agent_pos"][7:], LEAP.relaxed_joints, atol=0.05)
    assert not env.pad_forces.any()
    assert not info["holding"]


def test_a_restored_snapshot_replays_bit_for_bit_also_in_another_environment(any_env):
    any_env.reset(seed=SEED)
    wiggle(any_env, 3)
    snapshot = any_env.snapshot()
    expected = wiggle(any_env, 8, seed=1)
    other = make_env(any_env.task, cameras=())
    for env in (any_env, other):
        env.reset(seed=SEED + 1)
        env.restore(snapshot)
        assert same(wiggle(env, 8, seed=1), expected)


@pytest.mark.parametrize("task", RANGES)
def test_doing_nothing_and_acting_at_random_never_succeed(task):
    env = make_env(task, cameras=())
    low, high = env.action_space.low, env.action_space.high  # pyright: ignore[reportAttributeAccessIssue]
    for seed in range(3):
        env.reset(seed=seed)
        start, rng = env.command, np.random.default_rng(seed)
        for step in range(60):
            *_, info = env.step(rng.uniform(low, high) if seed else start)
            assert not info["is_success"], step
            assert info["progress"] < 0.5


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


def test_restored_snapshot_replays_touch_noise_and_latency():
    env = PlaceHammerEnv(cameras=(), touch=TouchConfig(latency_steps=2))
    env.reset(seed=SEED)
    wiggle(env, 4)
    snapshot = env.snapshot()
    expected = wiggle(env, 5)
    env.restore(snapshot)
    assert same(wiggle(env, 5), expected)


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


@pytest.mark.parametrize("task", TASKS)
def test_every_task_gives_the_fingers_the_configured_skin(task):
    def height(skin: float) -> float:
        env = make_env(task, cameras=(), touch=TouchConfig(skin=skin))
        env.reset(seed=SEED)
        # The outward pad normal is -x of the distal link.
        return -env.model.geom("if_skin").pos[0]

    assert height(0.003) - height(0.0015) == pytest.approx(0.0015, abs=1e-9)


def test_who_does_not_see_gets_the_last_images_and_all_else_as_ever():
    seen, blind = (PlaceHammerEnv() for _ in range(2))
    (start, _), _ = seen.reset(seed=SEED), blind.reset(seed=SEED)
    blind.seeing = False
    action = seen.command.astype(np.float32) + 0.05
    full, repeated = seen.step(action)[0], blind.step(action)[0]
    assert same(repeated.pop("pixels"), start["pixels"])
    assert not same(full.pop("pixels"), start["pixels"])
    assert same(full, repeated)
    assert same(blind.reset(seed=SEED)[0], start)
    assert blind.seeing
