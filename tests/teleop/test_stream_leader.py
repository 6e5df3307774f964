import gymnasium
import numpy as np
import pytest
from moving_hand import START, MovingHand, bent, record

from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.streams.files import ReplaySource
from lerobot_dexflex.streams.packets import PacketError
from lerobot_dexflex.teleop.stream_config import LeadConfig
from lerobot_dexflex.teleop.stream_leader import FOLLOWS, HOLDS, NO_WRIST, OPEN_YOUR_HAND, StreamLeader

CALIBRATED = 1.1
"""When a hand that is open from the start is calibrated [s]."""


@pytest.fixture
def said():
    return []


def lead(source, said, seconds, **how):
    """Let a source lead for a time; return the leader, and the joints after each tick."""
    engaged = how.pop("engaged", True)
    leader = StreamLeader(LEAP, source, said.append, LeadConfig(**how), engaged)
    leader.put(START)
    joints = []
    for now in np.arange(0.0, seconds, 0.02).tolist():
        leader.tick(now)
        joints.append(leader.joints)
    return leader, np.array(joints)


def moving(t):
    """Open and still until it is calibrated, then forward at 10 cm/s."""
    return record(t, place=(0.1 * max(0.0, t - CALIBRATED), 0.0, 1.0))


def test_the_person_is_asked_for_an_open_hand_and_then_leads(said):
    leader, joints = lead(MovingHand(moving), said, 2.0)
    assert leader.ready
    assert said[0] == OPEN_YOUR_HAND
    assert said[1] == "Calibrated: the robot's hand is 1.44 times yours, to 8 mm."
    assert said[2:] == [FOLLOWS]
    np.testing.assert_array_equal(joints[:49], np.tile(START, (49, 1)))
    assert np.abs(joints[-1] - START)[:7].max() > 0.03


def test_until_the_hand_is_open_the_robot_stays_and_is_not_ready(said):
    leader, joints = lead(MovingHand(lambda t: record(t, keypoints=bent(0.8), place=(t, 0, 1))), said, 1.5)
    assert not leader.ready
    np.testing.assert_array_equal(joints, np.tile(START, (len(joints), 1)))
    assert said == [OPEN_YOUR_HAND, "The index finger is bent. Open the hand."]


def test_the_person_is_told_once_that_the_stream_stopped_and_that_it_is_back(said):
    lead(MovingHand(lambda t: moving(t) if not 2.0 < t < 2.5 else None), said, 3.0)
    assert said[2:] == [FOLLOWS, HOLDS["stale"], FOLLOWS]


def test_a_hand_that_is_not_seen_and_a_wrist_that_is_not_known_are_told(said):
    lost = range(21)
    lead(MovingHand(lambda t: record(t, wrist=False) if t < 1.5 else record(t, lost=lost)), said, 2.0)
    assert said[2:] == [NO_WRIST, HOLDS["lost"]]


def test_a_key_takes_the_hand_and_releases_it(said):
    leader, joints = lead(MovingHand(moving), said, 1.5, engaged=False)
    assert said[1].endswith("to 8 mm. SPACE takes it, and releases it.")
    assert len(said) == 2
    np.testing.assert_allclose(joints[-1][:7], START[:7], atol=1e-9)
    for now, text in ((1.5, FOLLOWS), (1.54, HOLDS["released"])):
        leader.toggle()
        leader.tick(now)
        leader.tick(now + 0.02)
        assert said[-1] == text


def test_a_pause_of_the_caller_is_no_news(said):
    """Saving an episode takes a second, in which nobody looks."""
    leader, _ = lead(MovingHand(moving), said, 2.0)
    for now in (3.0, 3.02, 3.04, 3.06):
        leader.tick(now)
    assert said[2:] == [FOLLOWS]


def test_a_key_before_the_hand_is_calibrated_asks_for_it_again(said):
    leader, _ = lead(MovingHand(lambda t: None), said, 0.1)
    leader.toggle()
    assert said == [OPEN_YOUR_HAND, OPEN_YOUR_HAND]


def test_calibrating_again_holds_the_robot_where_it_is(said):
    leader, joints = lead(MovingHand(moving), said, 2.0)
    leader.calibrate()
    assert not leader.ready
    np.testing.assert_array_equal(leader.joints, joints[-1])


def test_a_command_is_the_same_for_all_steps_of_its_draft(said):
    from lerobot_dexflex.experts.command import fingertips_of

    leader, joints = lead(MovingHand(moving), said, 2.0)
    command = leader.command()
    assert command is not None
    np.testing.assert_array_equal(command.joint_targets, joints[-1])
    np.testing.assert_array_equal(command.executed, joints[-1])
    tips = fingertips_of(LEAP, joints[-1, 7:])
    np.testing.assert_array_equal(command.draft, np.tile(tips, (8, 1, 1)))
    assert not command.slipping


def test_when_a_stored_stream_has_ended_there_are_no_commands(said):
    records = [moving(t) for t in np.arange(0.0, 1.5, 0.01)]
    leader, _ = lead(ReplaySource(records), said, 1.4)
    assert not leader.over
    assert leader.command() is not None
    leader.tick(1.6)
    assert leader.over
    assert leader.command() is None


class RefusedHand(MovingHand):
    refusal = PacketError("hand", "The person wears the left glove only.")


def test_why_packets_are_refused_is_told_once(said):
    lead(RefusedHand(lambda t: None), said, 0.2)
    assert said == [OPEN_YOUR_HAND, "The person wears the left glove only."]


def test_a_reset_puts_the_robot_where_the_environment_is(said):
    leader, _ = lead(MovingHand(moving), said, 2.0)

    class Environment(gymnasium.Env):
        command = START + 0.1

    leader.begin(Environment(), 3)
    np.testing.assert_allclose(leader.joints, START + 0.1, atol=1e-9)
