"""A human's fingertips lead a robot's: a known similarity is found, and lost fingers stay."""

import numpy as np
import pytest
from synthetic_hand import HAND, LEFT_HAND, LEFTWARD, PLACE

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hand.kinematics import joint_limits
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.streams.record import Record
from lerobot_dexflex.streams.retarget import calibrate

JOINT_LOWER, JOINT_UPPER = joint_limits(LEAP)


TIPS = [8, 12, 16, 4]
"""Index, middle, ring, thumb."""
ROBOT = fingertips(LEAP.tables, np.array(LEAP.open_joints))
SCALE, OFFSET = 1.7, np.array([-0.14, -0.02, 0.03])
TURN = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]]) @ np.array(
    [[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]]
)


def record(points=HAND, tracked=None):
    return Record(0.0, PLACE, LEFTWARD, points, np.ones(21, bool) if tracked is None else tracked, True)


def human_of(robot, thumb_scale=1.0):
    """Return the hand whose fingertips the similarity leads to those of the robot."""
    points = HAND.copy()
    points[TIPS] = (robot - OFFSET) @ TURN / SCALE
    points[4] /= thumb_scale
    return points


@pytest.mark.parametrize("thumb_scale", [1.0, 1.25])
def test_a_known_similarity_is_found(thumb_scale):
    found = calibrate(LEAP, record(human_of(ROBOT, thumb_scale)), thumb_scale)
    assert found.scale == pytest.approx(SCALE)
    np.testing.assert_allclose(found.rotation, TURN, atol=1e-9)
    np.testing.assert_allclose(found.offset, OFFSET, atol=1e-9)
    assert found.residual < 1e-9
    joints = np.full(16, 0.4)
    elsewhere = human_of(fingertips(LEAP.tables, joints), thumb_scale)[TIPS]
    np.testing.assert_allclose(found(elsewhere), fingertips(LEAP.tables, joints), atol=1e-9)


def test_the_fit_is_the_best_one_and_says_how_good_it_is():
    human = HAND[TIPS]
    found = calibrate(LEAP, record())

    def error(scale, turn, offset):
        return np.sqrt(((scale * human @ turn.T + offset - ROBOT) ** 2).sum(1).mean())

    best = error(found.scale, found.rotation, found.offset)
    assert found.residual == pytest.approx(best)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)
    small = np.cos(0.01), np.sin(0.01)
    for sign in (-1, 1):
        assert error(found.scale + 0.01 * sign, found.rotation, found.offset) > best
        for axis in range(3):
            a, b = (k for k in range(3) if k != axis)
            turn = np.eye(3)
            turn[[a, b], [a, b]], turn[a, b], turn[b, a] = small[0], -sign * small[1], sign * small[1]
            assert error(found.scale, turn @ found.rotation, found.offset) > best
            assert error(found.scale, found.rotation, found.offset + 0.001 * sign * np.eye(3)[axis]) > best


def test_an_average_hand_fits_the_robots_open_hand_with_hardly_a_rotation():
    found = calibrate(LEAP, record())
    straight = calibrate(LEAP, record(), joints=np.zeros(16))
    assert (found.residual, straight.residual) == pytest.approx((0.008, 0.020), abs=0.0005)
    assert np.degrees(np.arccos((np.trace(found.rotation) - 1) / 2)) < 25
    assert 1.3 < found.scale < 2
    joints = np.array(LEAP.open_joints)
    assert (joints >= JOINT_LOWER.numpy()).all()
    assert (joints <= JOINT_UPPER.numpy()).all()


def test_what_touches_keeps_touching():
    found = calibrate(LEAP, record())
    pinch = HAND[TIPS]
    pinch[3] = pinch[0]
    moved = found(pinch)
    np.testing.assert_allclose(moved[3], moved[0])


def test_each_finger_leads_its_own():
    found = calibrate(LEAP, record())
    for row, point in enumerate(TIPS):
        points = HAND.copy()
        points[point] += 0.01
        moved = np.abs(found(points[TIPS]) - found(HAND[TIPS])).max(1) > 1e-3
        assert moved.tolist() == [k == row for k in range(4)], FINGER_NAMES[row]


def test_a_left_hand_must_be_mirrored():
    with pytest.raises(DexFlexError, match=r"left hand.*`mirror`"):
        calibrate(LEAP, record(LEFT_HAND))


def test_a_hand_that_shows_too_little_is_refused():
    with pytest.raises(DexFlexError, match="ring, thumb are lost"):
        calibrate(LEAP, record(tracked=~np.isin(np.arange(21), (4, 16))))
    line = HAND.copy()
    line[TIPS] = np.outer((1, 2, 3, 4), (0.03, 0.02, 0.01))
    with pytest.raises(DexFlexError, match="one line"):
        calibrate(LEAP, record(line))
    with pytest.raises(DexFlexError, match="`thumb_scale` must be positive"):
        calibrate(LEAP, record(), thumb_scale=0)
