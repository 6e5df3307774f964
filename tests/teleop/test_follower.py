import numpy as np
import pytest
from moving_hand import START, TIPS, MovingHand, bent, record, turned

from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.streams.retarget import calibrate
from lerobot_dexflex.streams.source import Newest
from lerobot_dexflex.teleop.clock import TICK
from lerobot_dexflex.teleop.fingers import RETURN_SPEED
from lerobot_dexflex.teleop.follower import Follower
from lerobot_dexflex.teleop.ik import RobotIK


@pytest.fixture
def follower():
    made = Follower(calibrate(LEAP, record(0.0)), START)
    made.engaged = True
    return made


def run(follower, at, seconds, start=0.0, rate=100.0, period=TICK):
    """Follow a hand for a time; return times [s], joints and statuses of all looks at it."""
    source = MovingHand(at, rate)
    times = start + period * np.arange(1, round(seconds / period) + 1)
    joints, statuses = [], []
    for now in times:
        follower.step(source.newest(now), now)
        joints.append(follower.joints)
        statuses.append(follower.status)
    return times, np.array(joints), statuses


def palm(joints):
    return RobotIK(LEAP, joints).palm


def forward(t, speed=0.1):
    """A wrist that moves forward [m/s] and stays open."""
    return record(t, place=(speed * t, 0.0, 1.0))


def test_the_palm_moves_and_turns_as_the_wrist(follower):
    run(follower, lambda t: record(t, place=(0.1 * t, 0.05 * t, 1.0), turn=turned(0.3 * t)), 1.0)
    here, start = palm(follower.joints), palm(START)
    np.testing.assert_allclose(here.rotation, turned(0.3) @ start.rotation, atol=0.02)
    pivot = calibrate(LEAP, record(0.0)).offset
    moved = here.position + here.rotation @ pivot - start.position - start.rotation @ pivot
    np.testing.assert_allclose(moved, (0.1, 0.05, 0.0), atol=5e-3)


def test_the_fingertips_go_where_the_persons_are(follower):
    run(follower, lambda t: record(t, keypoints=bent(0.3 * min(1.0, t))), 2.0)
    wish = calibrate(LEAP, record(0.0))(bent(0.3)[TIPS])
    np.testing.assert_allclose(fingertips(LEAP.tables, follower.joints[7:]), wish, atol=1e-3)


@pytest.mark.parametrize("rate", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("period", [TICK, 0.047])
def test_nothing_moves_on_a_record_older_than_100_ms(follower, rate, period):
    """The joints at looks from 0.1 s after it on are those of the look before, to the last bit."""

    def sent(t):
        return forward(t) if t < 0.5 else None

    times, joints, statuses = run(follower, sent, 1.0, rate=rate, period=period)
    last = np.floor((0.5 - 1e-9) * rate) / rate
    still = joints[np.flatnonzero(times >= last + 0.1)[0] - 1 :]
    np.testing.assert_array_equal(still, np.tile(still[0], (len(still), 1)))
    assert statuses[-1] == "stale"
    moving = joints[(times > 0.2) & (times <= last)]
    assert (np.abs(np.diff(moving[:, :7], axis=0)).max(1) > 0).all()


def test_a_hand_that_is_not_seen_stops_the_robot_at_once(follower):
    lost = range(21)
    times, joints, statuses = run(follower, lambda t: forward(t) if t < 0.5 else record(t, lost=lost), 1.0)
    still = joints[times >= 0.5]
    np.testing.assert_array_equal(still, np.tile(still[0], (len(still), 1)))
    assert statuses[-1] == "lost"


@pytest.mark.parametrize("how", ["stale", "lost", "released"])
def test_after_a_pause_the_arm_goes_on_from_where_it_is(follower, how):
    """The wrist comes back 10 cm farther left, the hand closed: nothing jumps."""
    lost = range(21)
    gone = {"lost": lambda t: record(t, lost=lost), "stale": lambda t: None, "released": forward}[how]
    run(follower, forward, 0.5)
    before = follower.joints
    follower.engaged = how != "released"
    _, _, statuses = run(follower, lambda t: forward(t) if t <= 0.5 else gone(t), 0.5, start=0.5)
    assert statuses[-1] == how
    assert np.abs(follower.joints - before)[:7].max() < 0.03
    follower.engaged = True
    held, hand = follower.joints, bent(0.6)

    def back(t):
        return record(t, keypoints=hand, place=(0.05, 0.1 + 0.1 * (t - 1.0), 1.0))

    _, joints, statuses = run(follower, back, 1.0, start=1.0)
    assert statuses[0] == "following"
    joints = np.concatenate([[held], joints])
    assert np.abs(np.diff(joints[:, :7], axis=0)).max() < 0.01
    tips = fingertips(LEAP.tables, np.ascontiguousarray(joints[:, 7:]))
    assert np.linalg.norm(np.diff(tips, axis=0), axis=-1).max() < RETURN_SPEED * TICK + 1e-3
    moved = palm(joints[-1]).position - palm(held).position
    np.testing.assert_allclose(moved, (0.0, 0.1, 0.0), atol=5e-3)


def test_what_its_source_calls_stale_leads_nobody(follower):
    run(follower, forward, 0.5)
    before = follower.joints
    for now in (0.52, 0.54):
        follower.step(Newest(forward(now), stale=True), now)
        assert follower.status == "stale"
    np.testing.assert_array_equal(follower.joints, before)


def test_a_released_hand_moves_nothing(follower):
    follower.engaged = False
    _, joints, statuses = run(follower, lambda t: record(t, keypoints=bent(t), place=(t / 10, 0, 1)), 0.5)
    np.testing.assert_array_equal(joints, np.tile(joints[0], (len(joints), 1)))
    assert set(statuses) == {"released"}


def test_before_the_first_record_the_robot_waits(follower):
    _, joints, statuses = run(follower, lambda t: None, 0.2)
    assert set(statuses) == {"waiting"}
    np.testing.assert_allclose(joints[-1], START, atol=2e-3)


def test_without_a_wrist_the_fingers_follow_and_the_arm_stays(follower):
    _, joints, statuses = run(follower, lambda t: record(t, keypoints=bent(0.3 * t), wrist=False), 1.0)
    assert statuses[-1] == "following"
    assert not follower.arm_follows
    np.testing.assert_array_equal(joints[-1, :7], joints[0, :7])
    assert np.abs(joints[-1, 7:] - joints[0, 7:]).max() > 0.1


def test_a_reset_begins_where_the_robot_is_and_couples_anew(follower):
    run(follower, forward, 0.5)
    follower.begin(START)
    np.testing.assert_allclose(follower.joints, START, atol=2e-3)
    run(follower, lambda t: record(t, place=(0.05, 0.1 * (t - 0.5), 1.0)), 1.0, start=0.5)
    moved = palm(follower.joints).position - palm(START).position
    np.testing.assert_allclose(moved, (0.0, 0.1, 0.0), atol=5e-3)


def test_after_a_pause_of_the_caller_the_palm_stays_and_goes_on_from_there(follower):
    """Nobody looked for 10 s, and meanwhile the wrist moved 14 cm."""
    run(follower, forward, 0.5)
    before = palm(follower.joints)
    run(follower, lambda t: record(t, place=(0.05, 0.14 + 0.1 * (t - 10.5), 1.0)), 1.0, start=10.5)
    np.testing.assert_allclose(palm(follower.joints).position - before.position, (0, 0.1, 0), atol=8e-3)
