"""FlipToast: a slice that stands and falls as friction asks, a success that means turned over."""

import mujoco
import numpy as np
import pytest
from env_checks import place, wait

from lerobot_dexflex.envs import flip_toast
from lerobot_dexflex.envs.flip_toast import GRIDDLE_HALF_SIZE, FlipToastEnv, add_slice
from lerobot_dexflex.envs.scene import add_block
from lerobot_dexflex.envs.spatula import BLADE_START, BLADE_TOP, GRIDDLE_HEIGHT, RIM_HEIGHT
from lerobot_dexflex.experts.tool.spatula import spatula_at
from lerobot_dexflex.hand import model as robot
from lerobot_dexflex.hand.arm import rotation_matrix
from lerobot_dexflex.hand.poses import quaternion_matrix

SEED = 7


@pytest.fixture(scope="module")
def env():
    return FlipToastEnv(cameras=())


@pytest.fixture
def held(monkeypatch):
    """Every spatula counts as held."""
    monkeypatch.setattr(flip_toast, "pinched", lambda *_: True)


def put_slice(env: FlipToastEnv, turned: float, x: float = -0.1, y: float = 0.0, above: float = 0.0) -> None:
    """Put the slice onto the griddle at x, y [m] in its frame, turned about its y axis [rad]."""
    origin, turn = env.griddle_pose
    width, height = env.episode.slice_half_size
    up = height + (width - height) * abs(np.sin(turned))
    rotation = turn @ rotation_matrix(np.array([0.0, turned, 0.0]))
    place(env, "toast", origin + turn @ np.array([x, y, up + above]), rotation)


def test_spatula_and_slice_lie_where_the_episode_says_and_stay(env):
    for seed in (0, 1):
        env.reset(seed=seed)
        episode = env.episode
        wait(env, 15)
        assert np.allclose(env.spatula_pose[0][:2], episode.stand[:2], atol=2e-3)
        origin, turn = env.griddle_pose
        gap, across, yaw = episode.slice
        width, height = episode.slice_half_size
        local = turn.T @ (env.food_pose[0] - origin)
        assert np.allclose(local, (-width - gap, across, height), atol=1e-3)
        askew = turn.T @ env.food_pose[1][:, 0]
        assert np.arctan2(askew[1], askew[0]) == pytest.approx(yaw, abs=0.01)


@pytest.mark.parametrize(("turned", "ends"), [(60, 0), (80, 0), (100, 180), (120, 180)])
def test_a_slice_on_its_edge_falls_to_the_side_that_it_leans_to(env, held, turned, ends):
    env.reset(seed=SEED)
    put_slice(env, np.radians(turned), above=0.0005)
    info = wait(env, 40)
    assert np.degrees(env.turned) == pytest.approx(ends, abs=2)
    assert info["is_success"] == (ends == 180)
    assert not info["dropped"]


def test_a_slice_that_falls_flat_does_not_fall_through_the_griddle(env, held):
    env.reset(seed=SEED)
    put_slice(env, np.pi, above=0.06)
    lowest = np.inf
    for _ in range(12):
        info = wait(env, 1)
        lowest = min(lowest, env.food_pose[0][2] - env.episode.slice_half_size[1] - GRIDDLE_HEIGHT)
        assert not info["dropped"]
    assert lowest > -0.001


@pytest.mark.parametrize(("steeper", "slides"), [(0.8, False), (1.2, True)])
def test_the_slice_slides_off_a_slope_as_its_friction_asks(steeper, slides):
    spec = robot.base_spec()
    slope = steeper * np.arctan(0.6)
    tilt = rotation_matrix(np.array([0.0, slope, 0.0]))
    plate = add_block(spec.worldbody, "slope", (0.3, 0.1, 0.01), (0, 0, 0), (1, 1, 1, 1))
    mujoco.mju_mat2Quat(quaternion := np.zeros(4), tilt.ravel())
    plate.quat = quaternion
    add_slice(spec, (0.037, 0.0065), 0.03)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = (*(tilt @ np.array([0, 0, 0.0167])), *quaternion)
    for _ in range(200):
        mujoco.mj_step(model, data)
    moved = tilt.T @ data.qpos[:3]
    assert (moved[0] > 0.02) == slides
    assert quaternion_matrix(data.qpos[3:])[:, 2] @ tilt[:, 2] > 0.99


def test_a_slice_turned_over_and_the_spatula_held_is_a_success_after_half_a_second(env, held):
    env.reset(seed=SEED)
    assert env._update()["progress"] < 0.4
    put_slice(env, np.pi, above=0.005)
    info = wait(env, 25)
    assert info["is_success"]
    assert info["progress"] == 1
    assert env.data.time >= 0.5


def test_it_is_none_without_the_spatula_in_the_hand(env):
    env.reset(seed=SEED)
    put_slice(env, np.pi)
    info = wait(env, 20)
    assert not info["is_success"]
    assert not info["dropped"]
    assert info["progress"] == 0


def test_a_slice_that_was_not_turned_or_lies_on_the_blade_is_none(env, held):
    env.reset(seed=SEED)
    assert not wait(env, 20)["is_success"]
    origin, turn = env.griddle_pose
    pose = spatula_at(origin + turn @ np.array([-0.05, 0, 0.0002]), env.episode.griddle[2], 0.0)
    on_blade = np.array([BLADE_TOP + env.episode.slice_half_size[1], 0.0, BLADE_START + 0.04])
    lying = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    env.reset(seed=SEED)
    env.model.body_gravcomp[env.model.body("spatula").id] = 1
    place(env, "spatula", *pose)
    place(env, "toast", pose.position + pose.rotation @ on_blade, pose.rotation @ lying)
    info = wait(env, 20)
    assert env.turned > np.radians(170)
    assert info["contacts"][4]
    assert not info["is_success"]
    assert info["progress"] < 1


def test_progress_grows_with_the_turn_and_never_falls(env, held):
    env.reset(seed=SEED)
    found = []
    for degrees in (20, 50, 80, 140, 60, 0):
        put_slice(env, np.radians(degrees), above=0.05)
        mujoco.mj_forward(env.model, env.data)
        found.append(env._update()["progress"])
    assert found[:4] == pytest.approx([0.3 + 0.6 * a / 180 for a in (20, 50, 80, 140)], abs=1e-6)
    assert found[4] == found[5] == found[3]


def test_a_slice_over_the_rim_or_beside_the_griddle_is_dropped(env, held):
    for x, y in ((0.06, 0.0), (-0.1, 0.14), (-2 * GRIDDLE_HALF_SIZE[0] - 0.06, 0.0)):
        env.reset(seed=SEED)
        put_slice(env, np.pi, x, y)
        info = wait(env, 20)
        assert info["dropped"]
        assert not info["is_success"]


def test_a_spatula_on_the_table_is_dropped_unless_it_is_held(env, monkeypatch):
    lying = rotation_matrix(np.array([0.0, np.pi / 2, 0.0])) @ rotation_matrix(np.array([0, 0, np.pi / 2]))
    for pinch in (False, True):
        monkeypatch.setattr(flip_toast, "pinched", lambda *_, pinch=pinch: pinch)
        env.reset(seed=SEED)
        place(env, "spatula", (0.3, -0.4, 0.05), lying)
        assert wait(env, 30)["dropped"] == (not pinch)


def test_the_scene_is_that_of_its_episode(env):
    env.reset(seed=SEED)
    episode, model = env.episode, env.model
    assert model.body("spatula").mass[0] == pytest.approx(episode.mass)
    assert model.body("toast").mass[0] == pytest.approx(episode.slice_mass)
    assert model.geom("spatula_handle").size[1] == episode.handle_half_width
    assert model.geom("if_tip").friction[0] == episode.tip_friction
    assert model.geom("blade").friction[0] == model.geom("blade_front").friction[0] == episode.blade_friction
    edge, (width, height) = model.geom("toast_edge0"), episode.slice_half_size
    assert np.hypot(*edge.pos[:2]) + edge.size[0] == pytest.approx(width)
    assert edge.size[0] == pytest.approx(height)
    tops = [model.geom(f"griddle_{name}") for name in ("rim", "side-1", "side1")]
    assert np.allclose([geom.pos[2] + geom.size[2] for geom in tops], RIM_HEIGHT)
