import numpy as np
import pytest
from moving_hand import TIPS, bent, record

from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.streams.record import Record
from lerobot_dexflex.streams.retarget import calibrate
from lerobot_dexflex.teleop.fingers import RETURN_SPEED, FingerLead

DT = 0.02
START = np.array([[0.13, 0.01, -0.02], [0.13, -0.04, -0.02], [0.13, -0.08, -0.02], [0.05, 0.08, -0.05]])
"""Near an open hand's fingertips."""


@pytest.fixture
def retargeting():
    return calibrate(LEAP, record(0.0))


@pytest.fixture
def fingers(retargeting):
    return FingerLead(retargeting, START)


def wish(retargeting, angle):
    return retargeting(bent(angle)[TIPS])


def follow(fingers, steps, **how):
    return [fingers.lead(record(0.0, **how), DT).copy() for _ in range(steps)][-1]


def test_fingers_come_to_the_persons_and_stay_with_them(fingers, retargeting):
    np.testing.assert_allclose(follow(fingers, 200), wish(retargeting, 0.0), atol=1e-12)
    np.testing.assert_allclose(follow(fingers, 1, keypoints=bent(0.5)), wish(retargeting, 0.5), atol=1e-12)


def test_the_way_to_the_person_is_covered_slowly(fingers):
    for _ in range(20):
        before = fingers.targets.copy()
        after = follow(fingers, 1)
        assert (np.linalg.norm(after - before, axis=1) <= RETURN_SPEED * DT + 1e-12).all()


def test_a_lost_finger_stays_and_comes_back_without_a_jump(fingers, retargeting):
    follow(fingers, 200)
    here = fingers.targets[1].copy()
    for angle in np.linspace(0.0, 0.8, 40):  # The middle finger, 12, is not seen while all of them bend.
        follow(fingers, 1, keypoints=bent(angle), lost=[12])
    np.testing.assert_array_equal(fingers.targets[1], here)
    np.testing.assert_allclose(fingers.targets[[0, 2, 3]], wish(retargeting, 0.8)[[0, 2, 3]], atol=1e-12)
    steps = []
    for _ in range(100):
        before = fingers.targets.copy()
        steps.append(np.linalg.norm(follow(fingers, 1, keypoints=bent(0.8))[1] - before[1]))
    assert max(steps) <= RETURN_SPEED * DT + 1e-12
    np.testing.assert_allclose(fingers.targets, wish(retargeting, 0.8), atol=1e-12)


def test_a_finger_that_comes_back_follows_at_once_on_its_way(fingers, retargeting):
    follow(fingers, 200)
    follow(fingers, 1, keypoints=bent(0.4), lost=[8])
    back = follow(fingers, 1, keypoints=bent(0.4))
    after = follow(fingers, 1, keypoints=bent(0.5))
    moved = wish(retargeting, 0.5) - wish(retargeting, 0.4)
    assert np.linalg.norm(after[0] - back[0] - moved[0]) <= RETURN_SPEED * DT + 1e-12


def test_fingers_that_were_never_seen_stay_where_the_robot_has_them(fingers):
    np.testing.assert_array_equal(fingers.lead(Record.lost(0.0), DT), START)


def test_after_a_reset_fingers_begin_where_the_robot_is(fingers):
    follow(fingers, 200)
    fingers.begin(START)
    np.testing.assert_array_equal(fingers.targets, START)
    assert np.abs(follow(fingers, 1) - START).max() <= RETURN_SPEED * DT


def test_after_a_reset_a_lost_finger_stays_where_the_robot_is(fingers):
    follow(fingers, 200, keypoints=bent(0.5))
    fingers.begin(START)
    np.testing.assert_array_equal(follow(fingers, 5, lost=[8])[0], START[0])
