"""The wrist's frame is made of the palm's points, wherever the hand is and whichever it is."""

import numpy as np
import pytest
from synthetic_hand import HAND, LEFT_HAND, LEFTWARD, PLACE, in_world

from lerobot_dexflex.streams.packets import PacketError
from lerobot_dexflex.streams.wrist_frame import flexion, record_of, wrist_frame


def random_turn(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * [1, 1, np.linalg.det(q)]


@pytest.mark.parametrize(("hand", "points"), [("right", HAND), ("left", LEFT_HAND)])
def test_axes_are_those_of_the_drawing(hand, points):
    """Either hand, back up, fingers to the world's +y: x is there, z up, y therefore to the world's -x."""
    frame = wrist_frame(in_world(points), hand)
    assert frame is not None
    np.testing.assert_allclose(frame.position, PLACE)
    np.testing.assert_allclose(frame.rotation, LEFTWARD, atol=1e-12)


@pytest.mark.parametrize(("hand", "points"), [("right", HAND), ("left", LEFT_HAND)])
def test_keypoints_do_not_depend_on_where_the_hand_is(hand, points):
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn, place = random_turn(rng), rng.normal(size=3)
        record = record_of(0.0, in_world(points, turn, place), hand)
        np.testing.assert_allclose(record.keypoints, points, atol=1e-12)
        np.testing.assert_allclose(record.wrist_rotation, turn, atol=1e-12)
        np.testing.assert_allclose(record.wrist_position, place)


def test_bending_fingers_does_not_turn_the_frame():
    bent = HAND.copy()
    bent[[6, 7, 8, 10, 11, 12, 14, 15, 16]] -= (0.03, 0.0, 0.05)
    frame = wrist_frame(bent)
    assert frame is not None
    np.testing.assert_allclose(frame.rotation, np.eye(3), atol=1e-12)


def test_a_mirrored_left_hand_is_a_right_hand_at_the_same_wrist():
    left = record_of(0.0, in_world(LEFT_HAND), "left", mirror=True)
    right = record_of(0.0, in_world(HAND), "right")
    for name in ("keypoints", "wrist_position", "wrist_rotation", "tracked"):
        np.testing.assert_allclose(getattr(left, name), getattr(right, name), atol=1e-12)


@pytest.mark.parametrize("point", [0, 5, 9, 13])
def test_a_hand_without_a_point_of_its_palm_is_lost(point):
    points = in_world(HAND)
    points[point] = np.nan
    assert record_of(1.0, points).is_lost


def test_a_palm_without_area_is_lost():
    for points in ([(0, 0, 0)] * 21, np.outer(HAND[:, 0], (1, 2, 3))):
        assert record_of(1.0, np.array(points, float)).is_lost


def test_another_lost_point_is_lost_alone():
    points = in_world(HAND)
    points[8] = np.nan
    record = record_of(1.0, points)
    assert not record.tracked[8]
    assert record.tracked.sum() == 20
    np.testing.assert_allclose(record.keypoints[record.tracked], HAND[record.tracked], atol=1e-12)


def test_points_in_other_units_are_refused():
    with pytest.raises(PacketError, match="convert units") as caught:
        record_of(1.0, 100 * HAND)
    assert caught.value.reason == "malformed"


def test_flexion_tells_a_hand_that_was_taken_for_the_other():
    # By hand: the tips of index, middle and ring are 16, 18 and 19 mm below the palm.
    assert flexion(record_of(0.0, in_world(HAND)).keypoints) == pytest.approx(0.053 / 3)
    assert flexion(record_of(0.0, in_world(LEFT_HAND), "left").keypoints) == pytest.approx(0.053 / 3)
    assert flexion(record_of(0.0, in_world(LEFT_HAND), "right").keypoints) == pytest.approx(-0.053 / 3)
