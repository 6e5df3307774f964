"""The arm's part of the operator: straight glides, waits that end, poses that fit what is held."""

import numpy as np
import pytest
from expert_checks import SEED, make_env

from lerobot_dexflex.experts.tool.hand import OperatorHand
from lerobot_dexflex.experts.tool.known_holds import holds_of
from lerobot_dexflex.experts.tool.script import PALM_DOWN, Pose, Script
from lerobot_dexflex.experts.tool.senses import Tool, ToolSenses
from lerobot_dexflex.hand.arm import ArmKinematics, rotation_matrix
from lerobot_dexflex.hand.objects import ObjectSpec
from lerobot_dexflex.hands import LEAP

GRASP_CENTRE = holds_of(LEAP).bar.centre


@pytest.fixture
def env():
    env = make_env("PlaceHammer-v0")
    env.reset(seed=SEED)
    return env


@pytest.fixture
def script(env):
    tool = Tool("hammer", ObjectSpec("cylinder", (0.013, 0.08), 0.1), np.zeros(3), 1.0)
    hand = OperatorHand(ToolSenses(env, tool), env.command, np.random.default_rng(0), 1.5, np.eye(3))
    return Script(env, hand, np.random.default_rng(0), GRASP_CENTRE)


@pytest.mark.parametrize(("true_from", "waited"), [(0, 0), (4, 4), (99, 12)])
def test_a_wait_ends_when_its_condition_holds_or_its_time_is_up(script, true_from, waited):
    commands = []
    for command in script.wait(lambda: len(commands) >= true_from, 12):
        commands.append(command)
    assert len(commands) == waited
    assert all(np.array_equal(c.joint_targets[:7], script._arm) for c in commands)


def test_a_glide_leads_the_grasp_point_straight_to_its_goal(env, script):
    start, goal = script.position, script.position + np.array([0.03, -0.02, 0.05])
    turned = script.rotation @ rotation_matrix(np.array([0.0, 0.0, 0.2]))
    commands = list(script.glide(goal, turned, 15))
    kinematics = ArmKinematics(LEAP, GRASP_CENTRE, env.command[:7])
    points = np.array([kinematics.forward(command.joint_targets[:7])[0] for command in commands])
    way = (goal - start) / np.linalg.norm(goal - start)
    assert np.linalg.norm(np.cross(points - start, way), axis=1).max() < 1e-3
    distance, angle = kinematics.error(commands[-1].joint_targets[:7], goal, turned)
    assert distance < 5e-4
    assert angle < 5e-3


def test_a_swing_ends_at_its_pose(env, script):
    goal = script.position + np.array([0.0, 0.05, 0.1])
    commands = list(script.swing(goal, PALM_DOWN, 20, tuple(env.command[:7])))
    assert len(commands) == 20
    kinematics = ArmKinematics(LEAP, GRASP_CENTRE, env.command[:7])
    distance, angle = kinematics.error(commands[-1].joint_targets[:7], goal, PALM_DOWN)
    assert distance < 1e-3
    assert angle < 5e-3


def test_care_calms_the_arm_gradually_and_changes_what_is_executed_only(script):
    def off(command):
        return np.abs(command.executed - command.joint_targets)[:7].mean()

    strayed = [off(command) for command in script.hold(400)]
    assert np.mean(strayed) == pytest.approx(0.025 * np.sqrt(2 / np.pi), rel=0.3)
    script.care = 0.0
    calming = [off(command) for command in script.hold(13)]
    assert calming[0] > 0
    assert calming[-1] == 0
    command = next(iter(script.hold(1)))
    assert np.array_equal(command.executed[:7], command.joint_targets[:7])
    assert not np.array_equal(command.executed[7:], command.joint_targets[7:])
    assert command.draft.shape == (8, 4, 3)
    assert command.slipping is False


def test_the_palm_for_a_held_object_brings_it_to_the_pose_asked_for(script):
    held = Pose(GRASP_CENTRE + np.array([0.01, 0.0, 0.02]), rotation_matrix(np.array([0.3, -0.2, 0.5])))
    position, rotation = np.array([0.5, 0.1, 0.3]), rotation_matrix(np.array([0.0, 0.4, 0.1]))
    point, palm = script.palm_for(held, position, rotation)
    origin = point - palm @ GRASP_CENTRE
    assert np.allclose(origin + palm @ held.position, position)
    assert np.allclose(palm @ held.rotation, rotation)


def test_how_an_object_is_held_is_its_measured_pose_in_the_palm(env, script):
    held = script.in_palm(*env.hammer_pose)
    palm, (position, rotation) = env.data.body("palm"), env.hammer_pose
    back = palm.xmat.reshape(3, 3)
    assert np.allclose(palm.xpos + back @ held.position, position)
    assert np.allclose(back @ held.rotation, rotation)
