"""What is bounded below every interface: no joint target is faster than the servo."""

import math

import pytest
import torch
from interface_cases import METHODS, STATE, drafts, hand_poses, held, measured, observation

from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import fingertips, joint_limits
from lerobot_dexflex.hand.model import SUBSTEPS, TIMESTEP
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.interfaces.commanded_hand import CommandedHand

JOINT_LOWER, JOINT_UPPER = joint_limits(LEAP)
LARGEST_STEP = float(LEAP.joint_speeds.min()) * CONTROL_PERIOD


ROUNDING = 1e-12
DRAFT_METHODS = [name for name in METHODS if name != "joint"]


def test_the_limit_is_what_the_servo_turns_in_a_control_step():
    assert CONTROL_PERIOD == TIMESTEP * SUBSTEPS
    assert LEAP.motors[0].speed * CONTROL_PERIOD == LARGEST_STEP
    assert math.isclose(LEAP.motors[0].speed, 8.48, abs_tol=0.01)
    assert math.isclose(LARGEST_STEP, 0.424, abs_tol=0.001)


@pytest.mark.parametrize("size", [0.05, 1.0, 1e6])
@pytest.mark.parametrize("name", METHODS)
def test_no_draft_and_no_jump_of_the_encoder_moves_a_joint_faster_than_it_can_turn(name, size):
    interface = make_interface(LEAP, name)
    before, steps = measured(observation(3))[0], []
    for k in range(20):
        seen = observation(3, seed=k)
        if k % 3 == 1:
            seen[STATE] = seen[STATE] + 2.0  # All encoders jump.
        targets = interface.step(seen if k else observation(3), drafts(name, 3, k, size=size))
        assert torch.isfinite(targets).all()
        steps.append(float((targets - before).abs().amax()))
        before = targets
    assert max(steps) <= LARGEST_STEP + ROUNDING
    if size <= 1.0:  # The limit was needed; kilometres away, inverse kinematics hardly moves.
        assert max(steps) > LARGEST_STEP - ROUNDING


@pytest.mark.parametrize("name", DRAFT_METHODS)
def test_targets_stay_within_the_joints_limits(name):
    interface, seen = make_interface(LEAP, name), observation(2)
    draft = held(torch.full((2, 4, 3), 0.5, dtype=torch.float64))
    for _ in range(10):
        targets = interface.step(seen, draft)
        assert (targets >= JOINT_LOWER - ROUNDING).all()
        assert (targets <= JOINT_UPPER + ROUNDING).all()


def test_the_speed_of_the_first_step_after_a_reset_counts_from_the_measured_hand():
    interface, draft = make_interface(LEAP, "joint"), torch.full((2, 1, 16), 2.0, dtype=torch.float64)
    first = interface.step(observation(2), draft)
    assert torch.equal(first, torch.minimum(draft[:, 0], measured(observation(2))[0] + LARGEST_STEP))
    interface.reset(torch.tensor([True, False]))
    seen = observation(2, seed=8)
    now = interface.step(seen, draft)
    assert torch.equal(now[0], torch.minimum(draft[0, 0], measured(seen)[0][0] + LARGEST_STEP))
    assert torch.equal(now[1], torch.minimum(draft[1, 0], first[1] + LARGEST_STEP))


def test_joint_targets_within_the_limit_pass_bit_for_bit_and_their_motion_is_told():
    interface, seen = make_interface(LEAP, "joint"), observation(2)
    draft = (seen[STATE][:, None, -16:] + 0.4).float()
    targets = interface.step(seen, draft)
    assert torch.equal(targets, draft[:, 0])
    expected = fingertips(LEAP, draft[:, 0].double()) - measured(seen)[1]
    torch.testing.assert_close(interface.motion, expected)


def test_a_jump_of_a_draft_is_made_up_in_several_steps_and_not_ignored():
    interface, seen = make_interface(LEAP, "raw"), observation(1)
    _, start, _ = measured(seen)
    goal = fingertips(LEAP, seen[STATE][:, -16:] + 0.6)
    assert ((goal - start).norm(dim=-1) > 0.03).all()
    joints = torch.empty(0)
    for _ in range(12):  # The hand follows.
        _, tips, _ = measured(seen)
        joints = interface.step(seen, held(goal - tips))
        seen = {STATE: joints}
    assert ((fingertips(LEAP, joints) - goal).norm(dim=-1) < 0.003).all()


@pytest.mark.parametrize("name", DRAFT_METHODS)
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_what_was_asked_outward_for_long_does_not_delay_the_way_back(name, axis, sign):
    """Most directions end with fingers stretched straight, where inverse kinematics would be stuck."""
    interface, seen = make_interface(LEAP, name), observation(1)
    seen = {STATE: seen[STATE]}
    draft = torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    draft[..., axis] = sign * 0.005
    joints = back = torch.empty(0)
    for _ in range(100):
        joints = interface.step(seen, draft)
    for _ in range(8):
        back = interface.step(seen, -draft)
    moved = sign * (fingertips(LEAP, joints) - fingertips(LEAP, back))[..., axis]
    assert (moved > 0.001).all(), moved


def test_joints_that_are_no_numbers_are_never_executed():
    hand, joints = CommandedHand(LEAP), hand_poses(2)
    hand.look({STATE: joints})
    with pytest.raises(DexFlexError, match=r"NaN or infinity in rows \[0, 1\]; nothing was executed"):
        hand.execute(joints * torch.nan)
    assert torch.equal(hand.posture, joints)


def test_the_posture_is_the_commanded_one_unless_it_is_told():
    hand, joints = CommandedHand(LEAP), hand_poses(2)
    hand.look({STATE: joints})
    executed = hand.execute(joints + 1.0)
    torch.testing.assert_close(executed, joints + LARGEST_STEP)
    assert torch.equal(hand.posture, executed)
    hand.execute(joints + 0.1, joints)
    assert torch.equal(hand.posture, joints)
