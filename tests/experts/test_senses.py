"""What the operator reads in the moving palm agrees with the simulator."""

import numpy as np
import pytest
from expert_checks import SEED, make_env

from lerobot_dexflex.experts import make_expert
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.contacts import fingertip_contacts
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hand.poses import quaternion_matrix
from lerobot_dexflex.hands import LEAP

CENTRE = np.array([0.087, 0.0, 0.083])
SHAPE = ObjectSpec("box", (0.008, 0.010, 0.067), 0.08)


@pytest.fixture(scope="module")
def env():
    """The pitcher of seed 11 in the air, tilted."""
    env = make_env("PourCup-v0")
    env.reset(seed=SEED)
    commands = make_expert("PourCup-v0")(env, np.random.default_rng(SEED))
    for command, _ in zip(commands, range(115), strict=False):
        env.step(command.executed)
    return env


@pytest.fixture(scope="module")
def senses(env):
    return ToolSenses(env, Tool("pitcher", SHAPE, CENTRE, env.episode.tip_friction))


def test_loads_points_and_normals_are_the_contacts_in_the_palm_frame(env, senses):
    now, direct = senses.read(), fingertip_contacts(LEAP, env.model, env.data, "pitcher")
    palm = env.data.body("palm")
    rotation = palm.xmat.reshape(3, 3)
    assert np.allclose(now.loads, direct.loads, atol=1e-9)
    touching = now.loads > 1e-6
    assert touching.sum() >= 3
    assert np.allclose(now.points[touching], ((direct.points - palm.xpos) @ rotation)[touching], atol=1e-9)
    assert np.allclose(now.inward[touching], (direct.inward @ rotation)[touching], atol=1e-9)
    assert np.allclose(np.linalg.norm(now.inward[touching], axis=1), 1)


def test_fingers_that_touch_nothing_have_no_normal_and_the_tip_as_point():
    env = make_env("PourCup-v0")
    env.reset(seed=SEED)
    now = ToolSenses(env, Tool("pitcher", SHAPE, CENTRE, 1.0)).read()
    assert not now.loads.any()
    assert not now.inward.any()
    assert np.array_equal(now.points, now.tips)


def test_the_pose_is_that_of_the_gripped_part_in_the_palm(env, senses):
    now = senses.read()
    palm, body = env.data.body("palm"), env.data.body("pitcher")
    rotation = palm.xmat.reshape(3, 3)
    handle = env.data.geom("pitcher_handle")
    assert np.allclose(palm.xpos + rotation @ now.position, handle.xpos, atol=1e-9)
    assert np.allclose(rotation @ now.rotation, body.xmat.reshape(3, 3), atol=1e-9)
    assert np.allclose(quaternion_matrix(now.quaternion), now.rotation, atol=1e-9)
    assert np.allclose(palm.xpos + rotation @ now.centre, body.xipos, atol=1e-9)


def test_joints_tips_gravity_and_mass_are_the_simulators(env, senses):
    now = senses.read()
    assert np.array_equal(now.joints, [env.data.joint(name).qpos[0] for name in LEAP.joint_names])
    assert np.allclose(now.tips, fingertips(LEAP.tables, now.joints), atol=1e-6)
    world = env.data.body("palm").xmat.reshape(3, 3) @ senses.gravity
    assert np.allclose(world, (0, 0, -9.81), atol=1e-9)
    assert senses.mass == pytest.approx(env.episode.mass)
    assert senses.friction == env.episode.tip_friction


def test_surface_samples_lie_on_the_gripped_part_and_repeat(senses):
    points, normals = senses.surface(50)
    assert np.allclose(np.abs(points / SHAPE.size).max(1), 1, atol=1e-6)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.array_equal(points, senses.surface(50)[0])
