"""The hand-written grip: who presses, how hard, and what it does without touch."""

import pytest
import torch
from interface_cases import STATE, TACTILE, held, measured, observation, still, touching

from lerobot_dexflex.envs.reach import ReachEnv
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kinematics import contact_torques, pads, solve_fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import make_interface
from lerobot_dexflex.interfaces.grip import RECENT, Grip, ServoSettings, loads_of

NO_SERVO = "servo=0+back=0"


def lead(interface, seen, draft):
    """Return by how much the joints lead those of `raw` [rad], (rows, 4 fingers, 4 joints), at first."""
    pressed = interface.step(seen, draft)
    return (pressed - make_interface(LEAP, "raw").step(seen, draft)).unflatten(1, (4, 4))


def outward_motion(seen, speed=0.003):
    """Return a motion of all fingertips away from what they touch [m]."""
    return -speed * measured(seen)[2]


@pytest.mark.parametrize("force", [0.5, 1.8])
def test_touching_fingers_lead_by_their_torques_over_the_gain_and_others_do_not(force):
    seen = touching([1.0, 0.0, 2.0, 0.02])
    joints, _, inward = measured(seen)
    centres, _ = pads(LEAP, joints)
    torques = contact_torques(LEAP, joints, centres, force * inward).unflatten(1, (4, 4))
    found = lead(make_interface(LEAP, f"press:{force}+{NO_SERVO}"), seen, still())
    torch.testing.assert_close(
        found[:, [0, 2]], torques[:, [0, 2]] / LEAP.motors[0].position_gain, atol=1e-12, rtol=0
    )
    assert not found[:, [1, 3]].any()
    assert found[:, [0, 2]].abs().amax() > 0.01


def test_the_lead_is_bounded_by_the_torque_of_the_motors():
    found = lead(make_interface(LEAP, f"press:60+{NO_SERVO}"), touching(1.0), still())
    assert found.abs().amax() == pytest.approx(LEAP.motors[0].grip_torque / LEAP.motors[0].position_gain)


def test_the_grip_is_no_motion():
    seen = touching(1.0)
    interface = make_interface(LEAP, "press:3@0.5")
    interface.step(seen, held(outward_motion(seen)))
    assert interface.motion is not None
    torch.testing.assert_close(interface.motion, 0.5 * outward_motion(seen))


def test_a_gain_scales_the_motion_and_not_the_grip():
    seen = touching(1.0)
    whole, half = make_interface(LEAP, "press:2"), make_interface(LEAP, "press:2@0.5")
    assert torch.equal(whole.step(seen, still()), half.step(seen, still()))


def test_the_next_posture_is_tied_to_the_one_without_the_grip():
    interface, seen = make_interface(LEAP, f"press:3+{NO_SERVO}"), touching(1.0)
    joints, tips, inward = measured(seen)
    motion = torch.full((1, 4, 3), 0.002, dtype=torch.float64)
    posture = solve_fingertips(LEAP, tips + motion, joints)
    interface.step(seen, held(motion))
    torques = contact_torques(LEAP, joints, pads(LEAP, joints)[0], 3.0 * inward)
    expected = solve_fingertips(LEAP, tips - motion, posture) + torques / LEAP.motors[0].position_gain
    torch.testing.assert_close(interface.step(seen, held(-motion)), expected, atol=1e-12, rtol=0)


def test_blocked_takes_the_outward_motion_of_loaded_fingers_and_nothing_else():
    seen = touching([1.0, 1.0, 0.0, 1.0])
    _, _, inward = measured(seen)
    sideways = torch.linalg.cross(inward, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(1, 4, 3))
    asked = 0.001 * sideways - 0.003 * inward
    asked[:, 1] = (0.001 * sideways + 0.003 * inward)[:, 1]  # This one closes.
    interface = make_interface(LEAP, "press:blocked=True")
    interface.step(seen, held(asked))
    expected = asked.clone()
    expected[:, [0, 3]] = (0.001 * sideways)[:, [0, 3]]
    assert interface.motion is not None
    torch.testing.assert_close(interface.motion, expected, atol=1e-15, rtol=0)
    free = make_interface(LEAP, "press")
    free.step(seen, held(asked))
    assert free.motion is not None
    assert torch.equal(free.motion, asked)


def test_a_finger_that_the_draft_takes_off_within_its_horizon_stops_pressing():
    seen = touching(1.0)
    _, _, inward = measured(seen)
    draft = still()
    draft[0, -1, 1] = -0.005 * inward[0, 1]  # Beyond the release, but only at the end.
    draft[0, -1, 2] = -0.003 * inward[0, 2]
    presses = (
        lead(make_interface(LEAP, f"press:release=0.004+{NO_SERVO}"), seen, draft).abs().amax((0, 2)) > 1e-3
    )
    assert presses.tolist() == [True, False, True, True]
    assert lead(make_interface(LEAP, f"press:{NO_SERVO}"), seen, draft).abs().amax((0, 2)).min() > 1e-3


def test_a_released_finger_is_no_longer_blocked():
    seen = touching(1.0)
    interface = make_interface(LEAP, "press:blocked=True+release=0.002")
    interface.step(seen, held(outward_motion(seen)))
    assert interface.motion is not None
    torch.testing.assert_close(interface.motion, outward_motion(seen))


def test_smoothing_averages_motions_with_its_weight_and_begins_at_the_first():
    interface, seen = make_interface(LEAP, "press:smoothing=0.25"), observation(2)
    steps = torch.tensor([0.001, 0.005, -0.020], dtype=torch.float64)
    expected = [0.001, 0.002, -0.0035]  # Each .75 of the last and .25 of the newest.
    for step, average in zip(steps, expected, strict=True):
        interface.step(seen, held(step.expand(2, 4, 3)))
        assert interface.motion is not None
        torch.testing.assert_close(interface.motion, torch.full_like(interface.motion, average))
    interface.reset(torch.tensor([True, False]))
    interface.step(seen, held(steps[0].expand(2, 4, 3)))
    assert interface.motion is not None
    torch.testing.assert_close(interface.motion[:, 0, 0].tolist(), [0.001, -0.0035 * 0.75 + 0.00025])


def test_a_finger_that_lost_its_load_goes_on_pressing_for_a_moment():
    interface, air = make_interface(LEAP, f"press:{NO_SERVO}"), touching(0.0)
    interface.step(touching(1.0), still())
    pressing = [not torch.equal(interface.step(air, still()), measured(air)[0]) for _ in range(RECENT + 1)]
    assert pressing == [True] * (RECENT - 1) + [False] * 2


NO_TOUCH = {
    "key absent": lambda seen: {STATE: seen[STATE]},
    "NaN": lambda seen: seen | {TACTILE: seen[TACTILE] * torch.nan},
    "infinity": lambda seen: seen | {TACTILE: seen[TACTILE] + torch.inf},
}


@pytest.mark.parametrize("fault", NO_TOUCH)
def test_without_touch_it_becomes_raw(fault):
    interface, raw, seen = make_interface(LEAP, "press:3"), make_interface(LEAP, "raw"), touching(1.0)
    draft = held(torch.full((1, 4, 3), 0.001, dtype=torch.float64))
    leads = []
    for k in range(20):
        told = interface.step(seen if k < 3 else NO_TOUCH[fault](seen), draft)
        leads.append(float((told - raw.step(seen, draft)).abs().amax()))
    assert min(leads[:5]) > 0.03  # It is held a moment more.
    assert max(leads[5:]) < 0.005  # What is left is the posture.


def test_one_broken_finger_does_not_keep_the_others_from_pressing():
    seen = touching(1.0)
    seen[TACTILE][0, 3] = torch.nan
    presses = lead(make_interface(LEAP, "press"), seen, still()).abs().amax((0, 2)) > 1e-3
    assert presses.tolist() == [False, True, True, True]


def exerted(grip, loads, force, steps=1):
    """Return how far the servo pushes each fingertip inward [m] after so many steps with these loads."""
    joints, _, inward = measured(observation(1))
    push = torch.empty(0)
    for _ in range(steps):
        felt = torch.tensor([loads], dtype=torch.float64)
        grip.feel(felt)
        forces = torch.as_tensor(force, dtype=torch.float64).expand(4)[:, None] * inward
        push = (grip.exert(joints, forces, felt).push * inward).sum(-1)[0]
    return push


def test_the_servo_integrates_the_missing_load_within_its_limits():
    servo = ServoSettings(gain=1e-4, limit=0.002)
    push = exerted(Grip(LEAP, servo), [1.0, 2.0, 3.0, 1.8], 2.0, steps=5)
    torch.testing.assert_close(push, torch.tensor([5e-4, 0.0, 0.0, 1e-4]).double(), atol=1e-9, rtol=0)
    assert exerted(Grip(LEAP, servo), [1.0] * 4, 2.0, steps=100).tolist() == pytest.approx([0.002] * 4)


def test_the_servo_lets_go_of_fingers_that_are_not_to_press_and_of_unknown_ones():
    grip = Grip(LEAP, ServoSettings(gain=1e-3, release=4e-4))
    assert exerted(grip, [1.0] * 4, 2.0).tolist() == pytest.approx([1e-3] * 4)
    push = exerted(grip, [1.0, 1.0, torch.nan, 1.0], [0.0, 2.0, 2.0, 0.0])
    assert push.tolist() == pytest.approx([6e-4, 2e-3, 6e-4, 6e-4])
    push = exerted(grip, [1.0, 1.0, torch.nan, 1.0], [0.0, 2.0, 2.0, 0.0], steps=2)
    assert push.tolist() == pytest.approx([0.0, 4e-3, 0.0, 0.0], abs=1e-12)


def test_a_finger_that_lost_its_load_a_moment_ago_is_sent_after_it():
    grip = Grip(LEAP, ServoSettings(gain=1e-4, back=5e-4))
    exerted(grip, [2.0] * 4, 2.0)
    assert exerted(grip, [0.0, 2.0, 2.0, 2.0], 2.0).tolist() == pytest.approx([5e-4, 0, 0, 0], abs=1e-12)


def test_the_servo_forgets_reset_rows_only():
    grip, loads = Grip(LEAP), torch.ones(2, 4, dtype=torch.float64)
    joints, _, inward = measured(observation(2))
    for _ in range(3):
        grip.feel(loads)
        grip.exert(joints, 3 * inward, loads)
    grip.reset(torch.tensor([True, False]))
    assert grip.feel(torch.zeros(2, 4)).tolist() == [[False] * 4, [True] * 4]
    push = grip.exert(joints, 0 * inward, loads).push.norm(dim=-1)
    assert not push[0].any()


def test_loads_are_sums_of_a_fingers_taxels():
    taxels = torch.zeros(1, 240)
    taxels[0, [0, 59, 60, 239]] = torch.tensor([1.0, 2.0, 3.0, 4.0])
    assert (
        loads_of(LEAP, taxels).tolist()
        == loads_of(LEAP, taxels.view(1, 4, 10, 6)).tolist()
        == [[3.0, 3.0, 0.0, 4.0]]
    )
    taxels[0, 61] = torch.inf
    assert loads_of(LEAP, taxels).isnan().tolist() == [[False, True, False, False]]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("press:-1", "`force` .* must be 0 or more"),
        ("press:release=-0.1", "`release` .* must be 0 or more"),
        ("press:smoothing=0", r"`smoothing` in \(0, 1\]"),
        ("press:smoothing=1.5", r"`smoothing` in \(0, 1\]"),
        ("press:servo=-1", "servo's `gain` must be 0 or more"),
        ("press:back=-1", "servo's `back` must be 0 or more"),
        ("press:limit=-1", "servo's `limit` must be 0 or more"),
    ],
)
def test_senseless_strengths_are_refused(name, message):
    with pytest.raises(DexFlexError, match=message):
        make_interface(LEAP, name)


def test_press_holds_what_raw_drops():
    env = ReachEnv(cameras=())
    first, _ = env.reset(seed=3)
    start, dropped = env.snapshot(), []
    for name in ("press:2.5", "raw"):
        env.restore(start)
        interface, seen, info = make_interface(LEAP, name), first, {}
        for _ in range(40):
            state = {
                STATE: torch.as_tensor(seen["agent_pos"])[None],
                TACTILE: torch.as_tensor(seen["tactile"])[None],
            }
            seen, _, _, _, info = env.step(interface.step(state, still())[0].numpy())
        dropped.append(info["dropped"])
    assert dropped == [False, True]
