import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from lerobot_dexflex.corpus.env import CorpusEnv
from lerobot_dexflex.corpus.world import Hinge, Push, Support, World, vary_object
from lerobot_dexflex.envs.reach import ReachEnv, ReachEpisode
from lerobot_dexflex.experts.reach.sensing import Senses
from lerobot_dexflex.hand.model import tip_geoms
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hand.poses import rotation_between


def test_a_world_and_an_episode_survive_json(hand, episode):
    world = World.sample(hand, np.random.default_rng(0))
    world.disturb(np.random.default_rng(1), 400, 0.1)
    world.supports.append(Support(0, None, (0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.0), 0.02))
    world.hinge = Hinge((0.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.0), (0.0, 0.6, 0.8), 0.01, 0.02)
    assert world.pushes
    assert world.slips
    stored = json.loads(json.dumps(world.to_dict()))
    assert json.loads(json.dumps(World.from_dict(stored).to_dict())) == stored
    assert World.from_dict(stored).gains == world.gains
    assert ReachEpisode.from_dict(json.loads(json.dumps(asdict(episode)))) == episode


def test_random_worlds_stay_within_their_ranges(hand):
    rng = np.random.default_rng(0)
    spec = ObjectSpec("box", (0.02, 0.02, 0.03), 0.1, 0.8)
    for _ in range(50):
        world = World.sample(hand, rng)
        world.disturb(rng, 100, 0.1)
        assert np.abs(np.array(world.gains) - 1).max() <= 0.15
        assert 0.7 <= world.damping <= 1.5
        assert all(0.2 <= np.linalg.norm(push.force) <= 2.0 for push in world.pushes)
        assert all(np.linalg.norm(push.torque) <= 0.03 for push in world.pushes)
        assert np.linalg.norm(world.sway) <= 4.0
        assert np.linalg.norm(world.lever) <= 0.05
        assert all(0.3 <= slip.share <= 0.7 for slip in world.slips)
        varied = vary_object(spec, rng)
        assert 0.06 <= varied.mass <= 0.15
        assert 0.6 <= varied.friction <= 1.0


def test_servos_and_damping_of_the_model_are_those_of_the_world(hand, episode, world):
    env = CorpusEnv(hand)
    env.start(episode, world)
    gains = hand.position_gains * np.array(world.gains)
    np.testing.assert_allclose(env.model.actuator_gainprm[:, 0], gains)
    np.testing.assert_allclose(env.model.actuator_biasprm[:, 1], -gains)
    damping = [1.2 * motor.damping for motor in hand.motors]
    np.testing.assert_allclose(env.model.dof_damping[: hand.n_joints], damping)


def test_wrenches_sway_and_slips_come_and_go(hand, episode, world):
    env = CorpusEnv(hand)
    env.start(episode, world)
    body, tip = env.model.body("object").id, env.model.geom(tip_geoms(hand)[0]).id
    friction, mass = env.model.geom_friction[tip, 0], env.model.body_mass[body]
    for step in range(28):
        env.advance(env.command)
        pushed, slipping = 5 <= step < 9, 20 <= step < 26
        wrench = np.array((0.0, 0.3, 0.2, 0.001, 0.0, 0.0)) if pushed else np.zeros(6)
        wrench[0] += mass * np.sin(2 * np.pi * step / 20)  # The palm sways with 1 m/s^2 in 20 steps.
        np.testing.assert_allclose(env.data.xfrc_applied[body], wrench, atol=1e-12)
        assert env.model.geom_friction[tip, 0] == pytest.approx(friction * (0.7 if slipping else 1.0))


def test_an_off_centre_weight_is_felt_as_a_torque_and_named_by_the_senses(hand, episode):
    env, moved = CorpusEnv(hand), CorpusEnv(hand)
    env.start(episode, World())
    moved.start(episode, World(lever=(0.0, 0.0, 0.03)))
    plain, heavy = Senses(env).read(), Senses(moved).read()
    np.testing.assert_allclose(heavy.centre - plain.centre, 0.03 * heavy.rotation[:, 2], atol=1e-12)
    lever = np.cross(heavy.centre - plain.centre, env.model.body("object").mass * env.model.opt.gravity)
    n = hand.n_joints
    gravity = [e.data.qfrc_bias[n : n + 3] for e in (env, moved)]
    np.testing.assert_allclose(gravity[0], gravity[1])
    torque = moved.data.qfrc_bias[n + 3 : n + 6] - env.data.qfrc_bias[n + 3 : n + 6]
    np.testing.assert_allclose(heavy.rotation @ torque, -lever, atol=1e-9)


def test_a_hinge_carries_the_object_and_turns_about_its_axis_against_friction(hand, episode):
    """Twice its friction turns the object, half of it does not; nothing else moves it."""
    axis = np.array((0.36, 0.48, 0.8))
    away = replace(episode, position=(0.0, 0.0, -0.3))  # Out of the fingers' reach.
    found = {}
    for share in (0.5, 2.0):
        env = CorpusEnv(hand)
        torque = tuple((share * 0.01 * axis).tolist())
        push = Push(0, 8, (0.0, 0.0, 0.0), torque)
        hinge = Hinge(away.position, away.quaternion, tuple(axis.tolist()), 0.01, 0.01)
        env.start(away, World(pushes=[push], hinge=hinge))
        assert env.supported
        for _ in range(8):
            env.advance(env.command)
        position, quaternion = env.object_pose
        assert np.linalg.norm(position - away.position) < 5e-4
        turned = rotation_between(np.array(away.quaternion), quaternion)
        found[share] = turned @ axis
        assert np.linalg.norm(turned - found[share] * axis) < 0.02
    assert found[2.0] > 0.5
    assert abs(found[0.5]) < 0.02


def test_heavy_and_slippery_objects_are_varied_within_what_a_hand_can_hold():
    rng = np.random.default_rng(0)
    heavy = [vary_object(ObjectSpec("box", (0.02, 0.02, 0.03), 0.25, 0.45), rng) for _ in range(50)]
    assert max(spec.mass for spec in heavy) == 0.3
    assert min(spec.friction for spec in heavy) == 0.4
    light = [vary_object(ObjectSpec("box", (0.02, 0.02, 0.03), 0.025, 1.1), rng) for _ in range(50)]
    assert min(spec.mass for spec in light) == 0.02
    assert max(spec.friction for spec in light) == 1.2


def test_a_fixture_carries_the_object_until_it_is_taken_away(hand, episode):
    env = CorpusEnv(hand)
    world = World(supports=[Support(0, 10, episode.position, episode.quaternion, 0.02)])
    env.start(episode, world)
    opened = np.clip(hand.relaxed_joints, hand.joint_lower, hand.joint_upper)
    for _ in range(10):
        assert env.supported
        env.advance(opened)
    assert np.linalg.norm(env.object_pose[0] - episode.position) < 0.003
    assert not env.supported
    for _ in range(10):
        env.advance(opened)
    assert np.linalg.norm(env.object_pose[0] - episode.position) > 0.03


def test_joint_noise_moves_joints_and_fingertips_alike(hand, episode):
    env = CorpusEnv(hand)
    clean, noisy = env.start(episode, World()), env.start(episode, World(joint_noise=0.01))
    moved = noisy["agent_pos"] - clean["agent_pos"]
    assert 0.003 < moved.std() < 0.03
    assert 1e-4 < np.abs(noisy["fingertips"] - clean["fingertips"]).max() < 5e-3


def test_the_seed_of_an_object_is_that_of_the_task(hand, seed, episode):
    env = ReachEnv(render_mode=None, cameras=(), hand=hand)
    env.reset(seed=seed)
    assert env.episode == episode
