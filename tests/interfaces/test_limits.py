"""What is bounded below every interface: the speed of joint targets, and how far a command runs away."""

import math

import pytest
import torch
from interface_cases import METHODS, STATE, drafts, hand_poses, observation

from lerobot_dexflex.conventions import CONTROL_PERIOD
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand import leap
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.hand.model import SUBSTEPS, TIMESTEP
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.interfaces.commanded_hand import LARGEST_STEP, RUNAWAY, CommandedHand
from lerobot_dexflex.interfaces.raw import RawInterface

STEPS, OUTWARD = 400, 0.005


def lead(interface, joints):
    """How far commanded fingertips are from where their joints put them [m]. Shape (batch, 4)."""
    return (interface.command - fingertips(joints)).norm(dim=-1)


def test_the_limit_is_what_the_servo_turns_in_a_control_step():
    assert CONTROL_PERIOD == TIMESTEP * SUBSTEPS
    assert math.isclose(leap.MAX_SPEED, 8.48, abs_tol=0.01)
    assert math.isclose(LARGEST_STEP, 0.424, abs_tol=0.001)


@pytest.mark.parametrize("name", METHODS)
def test_one_draft_of_a_metre_moves_no_joint_faster_than_it_can_turn(make, name):
    interface = make(name)
    before = observation(2)[STATE][:, -16:]
    draft = torch.full((2, 8, 4, 3), 1.0, dtype=torch.float64)
    if name == "joint":
        draft = torch.full((2, 8, 16), 3.0, dtype=torch.float64)
    targets = interface.step(observation(2), draft)
    step = (targets - before).abs().amax()
    assert step <= LARGEST_STEP + 1e-12
    if name in ("raw", "joint"):
        assert step > LARGEST_STEP - 1e-12
    assert (lead(interface, targets) <= RUNAWAY).all()
    after = interface.step(observation(2), -draft if name != "joint" else draft - 6.0)
    assert (after - targets).abs().amax() <= LARGEST_STEP + 1e-12


def test_the_speed_of_the_first_step_after_a_reset_counts_from_the_measured_or_the_initial_hand():
    interface, draft = make_interface("joint"), torch.full((2, 1, 16), 2.0, dtype=torch.float64)
    measured, initial = observation(2)[STATE][:, -16:], hand_poses(2, seed=8)
    expected = torch.minimum(draft[:, 0], measured + LARGEST_STEP)
    torch.testing.assert_close(interface.step(observation(2), draft), expected)
    interface.reset(torch.tensor([True, False]))
    interface.start(observation(2), initial)
    now = interface.step(observation(2), draft)
    torch.testing.assert_close(now[0], torch.minimum(draft[0, 0], initial[0] + LARGEST_STEP))
    torch.testing.assert_close(now[1], torch.minimum(draft[1, 0], expected[1] + LARGEST_STEP))


def test_joint_targets_within_the_limit_pass_bit_for_bit():
    interface, seen = make_interface("joint"), observation(2)
    draft = (seen[STATE][:, None, -16:] + 0.4).float()
    assert torch.equal(interface.step(seen, draft), draft[:, 0])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_command_that_ran_outward_for_long_comes_back_at_once(axis, sign):
    """Most directions end with fingers stretched straight, where inverse kinematics would be stuck."""
    assert_comes_back(make_interface("raw"), axis, sign, least=0.4 * OUTWARD)


@pytest.mark.parametrize("name", ["dexflex", "dexgen"])
def test_a_learned_interface_comes_back_from_outward_commands_as_well(name):
    assert_comes_back(make_interface(name), 2, -1, least=0.0005)  # They are slower than what is asked.


def assert_comes_back(interface, axis, sign, least):
    """Two steps back move every fingertip by so much [m]."""
    seen, draft = observation(1), torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    draft[..., axis] = sign * OUTWARD
    joints = torch.empty(0)
    for _ in range(STEPS):
        joints = interface.step(seen, draft)
        assert (lead(interface, joints) <= RUNAWAY).all()
    interface.step(seen, -draft)
    back = interface.step(seen, -draft)
    moved = sign * (fingertips(joints) - fingertips(back))[..., axis]
    assert (moved > least).all(), moved


def test_a_finger_whose_command_ran_away_stays_where_it_followed_until_it_is_told_to_come_back():
    hand, joints = CommandedHand(), hand_poses(1)
    hand.start({STATE: joints})
    reached, bent = fingertips(joints), joints + 0.05

    def command(distance, asked=joints):
        tips = reached.clone()
        tips[0, 1, 2] += distance
        executed, kept = hand.execute(asked, tips)
        assert torch.equal(kept[0, [0, 2, 3]], reached[0, [0, 2, 3]])
        return executed, float(kept[0, 1, 2] - reached[0, 1, 2])

    assert command(RUNAWAY - 1e-4)[1] == pytest.approx(RUNAWAY - 1e-4)
    executed, ahead = command(RUNAWAY + 0.01, bent)
    torch.testing.assert_close(executed[0, 4:8], joints[0, 4:8])
    torch.testing.assert_close(executed[0, [0, 8, 12]], bent[0, [0, 8, 12]])
    assert ahead == pytest.approx(0)
    assert command(0.007)[1] == pytest.approx(0)
    assert command(-0.001)[1] == pytest.approx(-0.001)
    assert command(0.007)[1] == pytest.approx(0.007)


def test_a_jump_of_a_plan_is_made_up_in_several_steps_and_not_ignored():
    interface, seen = RawInterface(), observation(1)
    start = interface.start(seen)
    goal = fingertips(seen[STATE][:, -16:] + 0.6)
    assert ((goal - start).norm(dim=-1) > RUNAWAY).all()
    joints = torch.empty(0)
    for _ in range(6):
        draft = (goal - interface.start(seen))[:, None].expand(-1, 8, -1, -1)
        joints = interface.step(seen, draft)
    assert ((fingertips(joints) - goal).norm(dim=-1) < 0.003).all()


def test_a_held_finger_may_go_sideways_as_far_as_it_follows():
    interface, seen = RawInterface(), observation(1)
    draft = torch.zeros(1, 8, 4, 3, dtype=torch.float64)
    draft[..., 2] = -OUTWARD
    for _ in range(100):
        interface.step(seen, draft)
    before = interface.start(seen)
    draft[..., 2], draft[..., 1] = 0.0, 0.003
    for _ in range(3):
        interface.step(seen, draft)
    assert interface.command is not None
    assert ((interface.command - before)[0, :3, 1] > 0.008).all()


def test_a_reset_row_is_no_longer_held():
    hand, joints = CommandedHand(), hand_poses(2)
    seen, tips = {STATE: joints}, fingertips(joints)
    hand.start(seen)
    hand.execute(joints, tips + 0.05)
    hand.reset(torch.tensor([True, False]))
    hand.start(seen)
    _, kept = hand.execute(joints, tips + 0.005)
    torch.testing.assert_close(kept[0], tips[0] + 0.005)
    torch.testing.assert_close(kept[1], tips[1])


def test_ordinary_commands_are_executed_as_ever():
    interface, seen = RawInterface(), observation(2)
    joints = seen[STATE][:, -16:]
    tips = fingertips(joints)
    for k in range(20):
        draft = drafts("raw", 2, seed=k)
        tips = tips + draft[:, 0]
        joints = solve_fingertips(tips, joints)
        assert torch.equal(interface.step(seen, draft), joints)
        assert interface.command is not None
        assert interface.command is not None
        assert torch.equal(interface.command, tips)


def test_joints_that_are_no_numbers_are_never_executed():
    hand, joints = CommandedHand(), hand_poses(2)
    hand.start({STATE: joints})
    with pytest.raises(DexFlexError, match=r"NaN or infinity in rows \[0, 1\]; nothing was executed"):
        hand.execute(joints * torch.nan)
    assert hand.joints is not None
    assert hand.joints is not None
    assert torch.equal(hand.joints, joints)
