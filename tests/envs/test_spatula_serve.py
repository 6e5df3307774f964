"""SpatulaServe: a blade that gets below a patty and lets it slide, a success that means served."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from env_checks import place, wait

from lerobot_dexflex.envs import spatula_serve
from lerobot_dexflex.envs.spatula import BLADE_START, BLADE_TOP, EDGE, add_spatula
from lerobot_dexflex.envs.spatula_serve import (
    PATTY_HALF_HEIGHT,
    PLATE_HEIGHT,
    PLATE_RADIUS,
    SpatulaServeEnv,
    add_patty,
)
from lerobot_dexflex.experts.tool.script import Pose
from lerobot_dexflex.experts.tool.spatula import spatula_at
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.arm import rotation_matrix

SEED = 7
ON_BLADE = np.array([BLADE_TOP + PATTY_HALF_HEIGHT, 0.0, BLADE_START + 0.04])
"""A patty's centre on the blade, in the spatula's frame [m]."""
LYING = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""How it is turned there: its axis is the spatula's x."""


@pytest.fixture(scope="module")
def env():
    return SpatulaServeEnv(cameras=())


@pytest.fixture
def held(monkeypatch):
    """Every spatula counts as held."""
    monkeypatch.setattr(spatula_serve, "pinched", lambda *_: True)


def lead(env: SpatulaServeEnv, pose_at: Callable[[float], Pose], seconds: float) -> None:
    """Lead the spatula along a path of poses, phase 0 to 1: weightless, and too heavy to be stopped."""
    body = env.model.body("spatula")
    env.model.body_gravcomp[body.id], body.mass[:], body.inertia[:] = 1, 100, 10
    dt, before = env.model.opt.timestep, pose_at(0.0).position
    steps = round(seconds / dt)
    for k in range(steps):
        pose = pose_at(k / steps)
        place(env, "spatula", *pose)
        env.data.joint("spatula").qvel[:3] = (pose.position - before) / dt
        before = pose.position
        mujoco.mj_step(env.model, env.data)
    mujoco.mj_forward(env.model, env.data)


def put_on_plate(env: SpatulaServeEnv, off_centre: float = 0.0, above: float = 0.0) -> None:
    x, y = env.episode.plate
    place(env, "patty", (x - off_centre, y, PLATE_HEIGHT + PATTY_HALF_HEIGHT + above))


def scoop(env: SpatulaServeEnv) -> None:
    """Push the blade along the griddle up to the rim, pitched down a little."""
    origin, turn = env.griddle_pose
    start, across = -0.13, env.episode.patty[1]

    def pose_at(phase: float) -> Pose:
        edge = origin + turn @ (start * (1 - phase) - 0.004 * phase, across, 0.0002)
        return spatula_at(edge, env.episode.griddle[2], -0.05)

    lead(env, pose_at, 1.5)


def test_spatula_and_patty_lie_where_the_episode_says_and_stay(env):
    for seed in (0, 1):
        env.reset(seed=seed)
        episode = env.episode
        wait(env, 15)
        yaw = episode.stand[2] + episode.spatula_yaw
        assert np.arccos(env.spatula_pose[1][:, 2] @ (np.cos(yaw), np.sin(yaw), 0)) < 0.03
        assert np.allclose(env.spatula_pose[0][:2], episode.stand[:2], atol=2e-3)
        origin, turn = env.griddle_pose
        local = turn.T @ (env.food_pose[0] - origin)
        gap, across, _ = episode.patty
        assert np.allclose(local, (-episode.patty_radius - gap, across, PATTY_HALF_HEIGHT), atol=1e-3)


@pytest.mark.parametrize("seed", [0, 3])
def test_a_blade_pushed_along_the_griddle_gets_below_the_patty(env, held, seed):
    env.reset(seed=seed)
    scoop(env)
    assert env._update()["progress"] == pytest.approx(3 / 6)
    height, across, along = env.food_on_spatula()
    assert height - BLADE_TOP == pytest.approx(PATTY_HALF_HEIGHT, abs=0.002)
    assert abs(across) < 0.008
    assert along - env.episode.patty_radius > BLADE_START
    position, rotation = env.spatula_pose
    lead(env, lambda phase: Pose(position + np.array([0, 0, 0.05 * phase]), rotation), 0.5)
    assert env.food_pose[0][2] > 0.05
    assert env._update()["progress"] == pytest.approx(4 / 6)


def test_a_blade_that_comes_too_high_does_not(env, held):
    env.reset(seed=SEED)
    origin, turn = env.griddle_pose
    lead(
        env,
        lambda phase: spatula_at(
            origin + turn @ (0.126 * phase - 0.13, 0, 0.006), env.episode.griddle[2], 0.0
        ),
        1.5,
    )
    assert env._update()["progress"] < 3 / 6


@pytest.mark.parametrize(("steeper", "slides"), [(0.8, False), (1.2, True)])
def test_the_patty_slides_off_a_fixed_blade_as_its_friction_asks(steeper, slides):
    friction, spec = 0.25, robot.base_spec()
    add_spatula(spec, 0.01, 0.05, friction)
    add_patty(spec, 0.034, 0.04)
    spec.delete(spec.joint("spatula"))
    pose = spatula_at(np.array([0.0, 0.0, 0.5]), 0.0, -steeper * np.arctan(friction))
    spec.body("spatula").pos = pose.position
    mujoco.mju_mat2Quat(quaternion := np.zeros(4), pose.rotation.ravel())
    spec.body("spatula").quat = quaternion
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mju_mat2Quat(quaternion, (pose.rotation @ LYING).ravel())
    data.qpos[:] = (*(pose.position + pose.rotation @ ON_BLADE), *quaternion)
    for _ in range(300):
        mujoco.mj_step(model, data)
    moved = pose.rotation.T @ (data.qpos[:3] - pose.position) - ON_BLADE
    assert (moved[2] > 0.02) == slides


def test_a_patty_on_the_plate_and_the_spatula_held_is_a_success_after_half_a_second(env, held):
    env.reset(seed=SEED)
    put_on_plate(env, 0.05, above=0.005)
    info = wait(env, 25)
    assert info["is_success"]
    assert info["progress"] == 1
    assert env.data.time >= 0.5


def test_it_is_none_without_the_spatula_in_the_hand(env):
    env.reset(seed=SEED)
    put_on_plate(env)
    info = wait(env, 20)
    assert not info["is_success"]
    assert not info["dropped"]


def test_a_patty_beside_the_plate_or_leaning_on_its_rim_is_not_served(env, held):
    for off_centre in (PLATE_RADIUS + 0.01, PLATE_RADIUS + 0.045):
        env.reset(seed=SEED)
        put_on_plate(env, off_centre)
        info = wait(env, 20)
        assert not info["is_success"]
        assert info["progress"] < 1
        assert info["dropped"]  # It touches the table.


def test_a_patty_that_still_lies_on_the_spatula_is_not_served(env, held):
    env.reset(seed=SEED)
    x, y = env.episode.plate
    pose = spatula_at(np.array([x + 0.03, y, PLATE_HEIGHT + 0.0002]), 0.0, 0.0)
    place(env, "spatula", *pose)
    place(env, "patty", pose.position + pose.rotation @ ON_BLADE, pose.rotation @ LYING)
    lead(env, lambda phase: pose, 0.5)
    env.memory.clear()
    infos = [env._update() for _ in range(12)]
    assert not any(info["is_success"] for info in infos)
    assert infos[-1]["progress"] < 1


def test_progress_stays_when_the_patty_is_put_back(env, held):
    env.reset(seed=SEED)
    back = env.food_pose[0].copy()
    put_on_plate(env)
    assert wait(env, 3)["progress"] == 1
    place(env, "patty", back)
    info = wait(env, 3)
    assert info["progress"] == 1
    assert not info["is_success"]


def test_a_patty_off_griddle_and_plate_is_dropped(env):
    env.reset(seed=SEED)
    assert not env._update()["dropped"]
    place(env, "patty", (0.3, -0.4, PATTY_HALF_HEIGHT))
    assert wait(env, 3)["dropped"]


def test_a_spatula_on_the_table_is_dropped_unless_it_is_held(env, monkeypatch):
    lying = rotation_matrix(np.array([0.0, np.pi / 2, 0.0])) @ rotation_matrix(np.array([0, 0, np.pi / 2]))
    for pinch in (False, True):
        monkeypatch.setattr(spatula_serve, "pinched", lambda *_, pinch=pinch: pinch)
        env.reset(seed=SEED)
        place(env, "spatula", (0.3, -0.4, 0.05), lying)
        assert wait(env, 30)["dropped"] == (not pinch)


def test_the_edge_is_thin_and_is_the_lowest_part_of_a_level_spatula(env):
    env.reset(seed=SEED)
    place(env, "spatula", *spatula_at(np.array([0.3, -0.4, 0.1]), 0.0, 0.0))
    mujoco.mj_kinematics(env.model, env.data)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = {}
    for name in ("blade", "blade_front", "spatula_neck", "spatula_handle"):
        geom = env.data.geom(name)
        corners[name] = geom.xpos + signs * env.model.geom(name).size @ geom.xmat.reshape(3, 3).T
    lowest = corners["blade_front"][corners["blade_front"][:, 2].argsort()]
    assert np.allclose(lowest[:2, [0, 2]], (0.3, 0.1), atol=3e-4)
    assert min(c[:, 2].min() for name, c in corners.items() if name != "blade_front") > 0.101
    front = lowest[lowest[:, 0] > 0.3 - 3e-4]
    assert np.ptp(front[:, 2]) < 0.0012
    assert env.model.geom("blade_front").size[0] == pytest.approx(0.0005)
    assert EDGE[0] < BLADE_TOP


def test_the_scene_is_that_of_its_episode(env):
    env.reset(seed=SEED)
    episode, model = env.episode, env.model
    assert model.body("spatula").mass[0] == pytest.approx(episode.mass)
    assert model.body("patty").mass[0] == pytest.approx(episode.patty_mass)
    assert model.geom("spatula_handle").size[1] == episode.handle_half_width
    assert model.geom("if_tip").friction[0] == episode.tip_friction
    assert model.geom("blade").friction[0] == model.geom("blade_front").friction[0] == episode.blade_friction
    assert np.allclose(model.geom("plate").pos[:2], episode.plate)
    edge = model.geom("patty_edge0")
    assert np.hypot(*edge.pos[:2]) + edge.size[0] < episode.patty_radius
    corner = np.hypot(np.hypot(*edge.pos[:2]), edge.size[1]) + edge.size[0]
    assert corner == pytest.approx(episode.patty_radius)
