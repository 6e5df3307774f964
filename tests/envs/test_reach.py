"""In-hand reaching: grasps that hold, goals by image only, honest success, exact snapshots."""

import mujoco
import numpy as np
import pytest
from env_checks import same, wiggle

from lerobot_dexflex.envs.reach import GOAL_ANGLE, GOAL_DISTANCE, STEADY_STEPS, ReachEnv
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.grasp import HOLD
from lerobot_dexflex.hand.poses import pose_error

SEED = 3


def carry_to_goal(env: ReachEnv) -> None:
    """Weld the object, now intangible, to the goal pose."""
    parts = env.model.geom_bodyid == env.model.body("object").id
    env.model.geom_contype[parts] = env.model.geom_conaffinity[parts] = 0
    weld = env.model.equality(HOLD).id
    position, quaternion = env.goal_pose
    env.model.eq_data[weld] = 0.0
    env.model.eq_data[weld, 3:10] = (*position, *quaternion)
    env.model.eq_data[weld, 10] = 1.0
    env.data.eq_active[weld] = 1
    env.data.joint("object_free").qpos[:] = (*position, *quaternion)
    env.data.joint("object_free").qvel[:] = 0


@pytest.fixture(scope="module")
def env():
    return ReachEnv(cameras=())


def test_there_are_sixteen_joints_and_no_object_or_goal_in_the_observation():
    env = ReachEnv()
    observation, info = env.reset(seed=SEED)
    assert {key: value.shape for key, value in observation.items() if key != "pixels"} == {
        "agent_pos": (16,),
        "tactile": (240,),
        "fingertips": (12,),
        "gravity": (3,),
    }
    assert env.action_space.shape == (16,)
    assert info.pop("contacts").tolist() == [False, True, True, True, False]
    assert info == {"is_success": False, "progress": 0.0, "dropped": False, "goals_reached": 0}
    # Another goal changes the pictures and nothing else.
    env.data.mocap_pos[0] += (0.0, 0.0, -0.03)
    mujoco.mj_forward(env.model, env.data)
    moved = env.observe()
    assert not same(moved["pixels"]["front"], observation["pixels"]["front"])
    for key in ("agent_pos", "fingertips", "gravity"):
        assert same(moved[key], observation[key])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_first_grasp_holds_under_its_own_command(env, seed):
    env.reset(seed=seed)
    start = env.object_pose
    for _ in range(60):
        _, _, terminated, _, info = env.step(env.command)
        assert not terminated
        assert not info["dropped"]
    distance, angle = pose_error(*start, *env.object_pose)
    assert distance < 2e-3
    assert angle < 0.05


def test_goals_lie_at_the_documented_distance(env):
    for seed in range(4):
        env.reset(seed=seed)
        distance, angle = pose_error(*env.object_pose, *env.goal_pose)
        assert GOAL_DISTANCE[0] <= distance <= GOAL_DISTANCE[1]
        assert GOAL_ANGLE[0] <= angle <= GOAL_ANGLE[1]


def test_success_needs_five_steady_steps_at_the_goal(env):
    env.reset(seed=SEED)
    command = env.command
    carry_to_goal(env)
    steps = [env.step(command) for _ in range(STEADY_STEPS)]
    assert [info["is_success"] for *_, info in steps] == [False] * (STEADY_STEPS - 1) + [True]
    assert [terminated for _, _, terminated, _, _ in steps] == [False] * (STEADY_STEPS - 1) + [True]
    assert [reward for _, reward, *_ in steps] == [0.0] * (STEADY_STEPS - 1) + [1.0]
    assert all(info["progress"] > 0.9 for *_, info in steps)
    assert steps[-1][4]["progress"] == 1.0


def test_a_reached_goal_is_followed_by_the_next_until_all_are_done():
    env = ReachEnv(goals=2, cameras=())
    env.reset(seed=SEED)
    first = env.goal_pose
    carry_to_goal(env)
    _, _, terminated, _, info = [env.step(env.command) for _ in range(STEADY_STEPS)][-1]
    assert not terminated
    assert info["goals_reached"] == 1
    assert 0.5 <= info["progress"] < 0.6
    distance, angle = pose_error(*env.object_pose, *env.goal_pose)
    assert GOAL_DISTANCE[0] <= distance <= GOAL_DISTANCE[1]
    assert GOAL_ANGLE[0] <= angle <= GOAL_ANGLE[1]
    assert not same(first[0], env.goal_pose[0])


def test_opening_the_hand_drops_the_object_and_ends_the_episode(env):
    env.reset(seed=SEED)
    steps = [env.step(np.zeros(16)) for _ in range(30)]
    assert any(terminated for _, _, terminated, _, _ in steps)
    for _, _, terminated, _, info in steps:
        assert terminated is info["dropped"]
        assert not info["is_success"]


def test_a_snapshot_replays_bit_for_bit_also_elsewhere_and_with_turning_gravity():
    env = ReachEnv(cameras=(), gravity_rate=0.5, goals=3)
    env.reset(seed=SEED)
    wiggle(env, 3)
    snapshot = env.snapshot()
    run = wiggle(env, 6, seed=1)
    physics, goal = env.snapshot().physics, env.goal_pose
    other = ReachEnv(cameras=(), gravity_rate=0.5, goals=3)
    other.reset(seed=SEED + 1)
    for again in (env, other):
        again.restore(snapshot)
        assert same(wiggle(again, 6, seed=1), run)
        assert same(again.snapshot().physics, physics)
        assert same(again.goal_pose[0], goal[0])


def test_gravity_turns_at_the_given_rate_and_keeps_its_strength():
    env = ReachEnv(cameras=(), gravity_rate=0.4)
    observation, _ = env.reset(seed=SEED)
    start = observation["gravity"].astype(float)
    for _ in range(10):
        observation = env.step(env.command)[0]
    axis = np.array(env.episode.gravity_axis)
    # Rodrigues' rotation by 10 steps x 0.05 s x 0.4 rad/s.
    angle = 10 * 0.05 * 0.4
    turned = start * np.cos(angle) + np.cross(axis, start) * np.sin(angle)
    turned += axis * (axis @ start) * (1 - np.cos(angle))
    assert observation["gravity"] == pytest.approx(turned, abs=1e-6)
    assert np.linalg.norm(env.model.opt.gravity) == pytest.approx(9.81)
    still = ReachEnv(cameras=())
    still.reset(seed=SEED)
    assert same(still.step(still.command)[0]["gravity"], start.astype(np.float32))


def test_rays_draw_the_ghost_as_opengl_does(opengl):
    from lerobot_dexflex.envs.rendering import Camera

    env = ReachEnv(cameras=())
    env.reset(seed=0)
    by_gl, by_rays = (Camera(env.model, "front", backend=b).render(env.data) for b in ("gl", "ray"))
    difference = np.abs(by_gl.astype(int) - by_rays)
    assert difference.mean() < 0.6
    assert (difference.max(axis=-1) > 8).mean() < 0.015


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goals": 0}, "`goals` must be at least 1. Got 0"),
        ({"gravity_rate": float("nan")}, "`gravity_rate` must be finite"),
        ({"cameras": ("side",)}, "Valid cameras"),
    ],
)
def test_senseless_options_are_refused(options, message):
    with pytest.raises(DexFlexError, match=message):
        ReachEnv(**options)


def test_an_action_for_the_whole_robot_is_refused(env):
    env.reset(seed=SEED)
    with pytest.raises(DexFlexError, match=r"must have shape \(16,\)"):
        env.step(np.zeros(23))
