"""`raw` moves the fingertips from where they are measured, and nothing else."""

import pytest
import torch
from interface_cases import drafts, held, measured, observation, still, touching

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.hand.kinematics import fingertips, solve_fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface


@pytest.mark.parametrize("arm", [0, 7])
def test_raw_solves_for_the_measured_tips_plus_the_first_step_of_the_draft(arm):
    interface, draft, seen = make_interface(LEAP, "raw"), drafts("raw", 3), observation(3, arm=arm)
    joints, tips, _ = measured(seen)
    assert torch.equal(interface.step(seen, draft), solve_fingertips(LEAP, tips + draft[:, 0], joints))
    assert interface.motion is not None
    assert torch.equal(interface.motion, draft[:, 0])


def test_a_still_draft_keeps_the_tips_where_they_are_measured_whatever_was_asked_before():
    interface = make_interface(LEAP, "raw")
    interface.step(observation(1), held(torch.full((1, 4, 3), 0.01)))
    seen = observation(1, seed=3)
    _, tips, _ = measured(seen)
    joints = torch.empty(0)
    for _ in range(20):
        joints = interface.step(seen, still())
    torch.testing.assert_close(fingertips(LEAP, joints), tips, atol=2e-4, rtol=0)


def test_a_hand_that_does_not_follow_is_asked_for_the_same_and_not_for_more():
    interface, seen = make_interface(LEAP, "raw"), touching(3.0)
    _, tips, _ = measured(seen)
    draft = held(torch.full((1, 4, 3), 0.002, dtype=torch.float64))
    joints = torch.empty(0)
    for _ in range(50):
        joints = interface.step(seen, draft)
    torch.testing.assert_close(fingertips(LEAP, joints), tips + 0.002, atol=3e-4, rtol=0)


def test_the_posture_is_tied_to_the_previous_command_and_not_to_the_measured_hand():
    interface, draft = make_interface(LEAP, "raw"), drafts("raw", 1)
    first = interface.step(observation(1), draft)
    seen = observation(1, seed=5)
    _, tips, _ = measured(seen)
    second = interface.step(seen, draft)
    assert torch.equal(second, solve_fingertips(LEAP, tips + draft[:, 0], first))
    assert not torch.equal(second, solve_fingertips(LEAP, tips + draft[:, 0], measured(seen)[0]))


def test_a_gain_scales_the_motion():
    seen, draft = observation(2), drafts("raw", 2)
    half, raw = make_interface(LEAP, "raw@0.5"), make_interface(LEAP, "raw")
    assert torch.equal(half.step(seen, draft), raw.step(seen, 0.5 * draft))
    assert half.motion is not None
    assert torch.equal(half.motion, 0.5 * draft[:, 0])


def test_a_draft_of_motion_lets_go_and_one_that_commands_into_the_object_holds_it():
    """A draft that only says where tips are holds no force: this is why there are grips."""
    env = ReachEnv(cameras=())
    first, _ = env.reset(seed=3)
    start, squeeze = env.snapshot(), fingertips(LEAP, torch.as_tensor(env.command)[None])
    dropped = []
    for presses in (True, False):
        env.restore(start)
        interface, seen, info = make_interface(LEAP, "raw"), first, {}
        for _ in range(30):
            state = {"observation.state": torch.as_tensor(seen["agent_pos"])[None]}
            draft = held(squeeze - measured(state)[1]) if presses else still()
            seen, _, _, _, info = env.step(interface.step(state, draft)[0].numpy())
        dropped.append(info["dropped"])
    assert dropped == [False, True]
