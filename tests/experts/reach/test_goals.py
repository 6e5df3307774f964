"""Goals are drawn as told, and those called feasible are feasible by their own criteria."""

import mujoco
import numpy as np
import pytest
import torch

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.experts.reach.chains import HeldObject
from lerobot_dexflex.experts.reach.fingers import Mode
from lerobot_dexflex.experts.reach.goals import ANGLE, DISTANCE, INSIDE, RADIUS, GoalDraws, draw_goal
from lerobot_dexflex.hand.grasp import OBJECT
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.hand.poses import pose_error, quaternion_matrix
from lerobot_dexflex.hands import LEAP

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module", params=[50_000, 50_003, 50_007])
def held(request):
    return HeldObject(ReachEnv(cameras=()), request.param)


def test_goals_move_turn_or_do_both_a_third_of_the_time_each():
    rng, centre = np.random.default_rng(0), np.array([0.1, 0.2, 0.3])
    found = np.array([pose_error(*draw_goal(centre, UPRIGHT, rng), centre, UPRIGHT) for _ in range(600)])
    moved, turned = found[:, 0] >= DISTANCE[0], found[:, 1] >= ANGLE[0]
    assert (moved | turned).all()
    assert found.max(0) == pytest.approx([DISTANCE[1], ANGLE[1]], rel=0.03)
    assert (found[~moved, 0] <= INSIDE[0] + 1e-9).all()
    assert (found[~turned, 1] <= INSIDE[1] + 1e-9).all()
    for share in ((moved & turned).mean(), (moved & ~turned).mean(), (~moved & turned).mean()):
        assert share == pytest.approx(1 / 3, abs=0.06)


def test_a_seed_decides_the_draw(held):
    draws, now = GoalDraws(held.operator, held.home), held.senses.read()
    here = now.position, now.quaternion
    first, second, other = (draws.draw(np.random.default_rng(seed), now, here) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.pose[0], second.pose[0])
    np.testing.assert_array_equal(first.pose[1], second.pose[1])
    assert not np.array_equal(first.pose[0], other.pose[0])


def test_what_is_called_feasible_is_within_reach_free_near_home_and_apart(held):
    draws, now = GoalDraws(held.operator, held.home), held.senses.read()
    here = now.position, now.quaternion
    previous, found = here, 0
    for seed in range(12):
        before = held.env.data.qpos.copy()
        pose, feasible = draws.draw(np.random.default_rng(seed), now, here, previous)
        np.testing.assert_array_equal(held.env.data.qpos, before)  # It looks in a world of its own.
        if not feasible:
            continue
        found += 1
        distance, angle = pose_error(*pose, *previous)
        assert distance > DISTANCE[0] or angle > ANGLE[0]
        assert np.linalg.norm(pose[0] - held.home) <= RADIUS
        assert_within_reach(held, now, pose)
        previous = pose
    assert found >= 3


def assert_within_reach(held, now, pose):
    """Holding fingertips get to their places on the object, within the joints' ranges, no link in the way."""
    fingers = held.operator.fingers
    holding = fingers.mode == Mode.HOLD
    places = pose[0] + fingers.anchor @ quaternion_matrix(pose[1]).T
    wanted = torch.from_numpy(np.where(holding[:, None], places, now.tips))[None]
    joints = solve_fingertips(
        LEAP, wanted, torch.from_numpy(now.joints)[None], posture_weight=0.004, iterations=8
    )
    missed = (fingertips(LEAP, joints) - wanted).norm(dim=-1)[0].numpy()
    assert missed[holding].max() < 0.003
    angles = joints.numpy().reshape(4, 4)[holding]
    assert (angles >= LEAP.joint_lower.reshape(4, 4)[holding]).all()
    assert (angles <= LEAP.joint_upper.reshape(4, 4)[holding]).all()
    model = held.env.model
    data = mujoco.MjData(model)
    data.qpos[:] = (*joints[0].numpy(), *pose[0], *pose[1])
    mujoco.mj_fwdPosition(model, data)
    touched = set()
    for contact in data.contact:
        names = [model.body(model.geom_bodyid[geom]).name for geom in contact.geom]
        if OBJECT in names and contact.dist < 0:
            touched |= set(names) - {OBJECT}
    assert touched <= {f"{finger}_ds" for finger in LEAP.prefixes}


def test_a_goal_that_no_finger_reaches_is_called_infeasible_and_the_nearest_is_given(held):
    draws, now = GoalDraws(held.operator, held.home), held.senses.read()
    far = now.position + np.array([0.0, 0.0, 0.2]), now.quaternion
    draw = draws.draw(np.random.default_rng(0), now, far)
    assert not draw.feasible
    assert np.linalg.norm(draw.pose[0] - far[0]) <= DISTANCE[1]


def test_goals_far_from_where_the_episode_began_are_infeasible(held):
    now = held.senses.read()
    here = now.position, now.quaternion
    draws = GoalDraws(held.operator, held.home + np.array([0.0, 0.0, RADIUS + DISTANCE[1] + 1e-3]))
    assert not draws.draw(np.random.default_rng(0), now, here).feasible
