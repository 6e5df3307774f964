"""A human's fingertips lead a robot's: a known similarity is found, and lost fingers stay."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_hand import HAND, LEFT_HAND, LEFTWARD, PLACE

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hand.kernels import fingertips
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.streams.record import Record, leading_tips
from lerobot_dexflex.streams.retarget import calibrate

TIPS = {"leap": [8, 12, 16, 4], "sharpa": [8, 12, 16, 20, 4]}
"""Index, middle, ring, perhaps the little finger, thumb."""
SCALE, OFFSET = 1.7, np.array([-0.14, -0.02, 0.03])
TURN = np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]]) @ np.array(
    [[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]]
)


def record(points=HAND, tracked=None):
    return Record(0.0, PLACE, LEFTWARD, points, np.ones(21, bool) if tracked is None else tracked, True)


@pytest.fixture(params=[LEAP, SHARPA], ids=lambda hand: hand.name)
def hand(request):
    return request.param


def turned(hand):
    """Return `TURN` for the hand whose palm it is: fingers along x, or along z and the palm toward x."""
    return TURN if hand is LEAP else np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]) @ TURN


def opened(hand):
    return fingertips(hand.tables, np.array(hand.open_joints))


def human_of(hand, robot, thumb_scale=1.0):
    """Return the hand whose fingertips the similarity leads to those of the robot."""
    points = HAND.copy()
    points[TIPS[hand.name]] = (robot - OFFSET) @ turned(hand) / SCALE
    points[4] /= thumb_scale
    return points


@pytest.mark.parametrize("thumb_scale", [1.0, 1.25])
def test_a_known_similarity_is_found(hand, thumb_scale):
    found = calibrate(hand, record(human_of(hand, opened(hand), thumb_scale)), thumb_scale)
    assert found.scale == pytest.approx(SCALE)
    np.testing.assert_allclose(found.rotation, turned(hand), atol=1e-9)
    np.testing.assert_allclose(found.offset, OFFSET, atol=1e-9)
    assert found.residual < 1e-9
    bent = fingertips(hand.tables, np.array(hand.nominal_joints))
    elsewhere = human_of(hand, bent, thumb_scale)[TIPS[hand.name]]
    np.testing.assert_allclose(found(elsewhere), bent, atol=1e-9)


def test_the_fit_is_the_best_one_and_says_how_good_it_is(hand):
    human, robot = HAND[TIPS[hand.name]], opened(hand)
    found = calibrate(hand, record())

    def error(scale, turn, offset):
        return np.sqrt(((scale * human @ turn.T + offset - robot) ** 2).sum(1).mean())

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


@pytest.mark.parametrize(
    ("hand", "residuals", "scales"),
    [(LEAP, (0.008, 0.020), (1.3, 2.0)), (SHARPA, (0.0067, 0.016), (0.9, 1.1))],
    ids=lambda value: getattr(value, "name", None),
)
def test_an_average_hand_fits_the_robots_open_hand_with_hardly_a_rotation(hand, residuals, scales):
    found = calibrate(hand, record())
    straight = calibrate(hand, record(), joints=np.zeros(hand.n_joints))
    assert (found.residual, straight.residual) == pytest.approx(residuals, abs=0.0005)
    palm = turned(hand) @ TURN.T
    assert np.degrees(np.arccos((np.trace(found.rotation @ palm.T) - 1) / 2)) < 25
    assert scales[0] < found.scale < scales[1]


def test_what_touches_keeps_touching(hand):
    found = calibrate(hand, record())
    pinch = HAND[TIPS[hand.name]]
    pinch[-1] = pinch[0]
    moved = found(pinch)
    np.testing.assert_allclose(moved[-1], moved[0])


def test_each_finger_leads_its_own(hand):
    found, tips = calibrate(hand, record()), leading_tips(hand)
    assert tips == TIPS[hand.name]
    for row, point in enumerate(tips):
        points = HAND.copy()
        points[point] += 0.01
        moved = np.abs(found(points[tips]) - found(HAND[tips])).max(1) > 1e-3
        assert moved.tolist() == [k == row for k in range(hand.n_fingers)], hand.finger_names[row]


def test_a_little_finger_leads_only_hands_that_have_one():
    points = HAND.copy()
    points[17:21] += (0.0, 0.01, 0.0)
    assert calibrate(LEAP, record(points)).scale == calibrate(LEAP, record()).scale
    assert calibrate(SHARPA, record(points)).scale != calibrate(SHARPA, record()).scale


def test_a_finger_that_no_person_has_is_refused():
    fingers = tuple(replace(finger, name=f"{finger.name}2") for finger in SHARPA.fingers)
    strange = replace(SHARPA, fingers=fingers, opposing=("thumb2",))
    with pytest.raises(DexFlexError, match="no finger 'index2' to lead that of 'sharpa'"):
        calibrate(strange, record())


def test_a_left_hand_must_be_mirrored(hand):
    with pytest.raises(DexFlexError, match=r"left hand.*`mirror`"):
        calibrate(hand, record(LEFT_HAND))


def test_a_hand_that_shows_too_little_is_refused():
    with pytest.raises(DexFlexError, match="ring, thumb are lost"):
        calibrate(LEAP, record(tracked=~np.isin(np.arange(21), (4, 16))))
    line = HAND.copy()
    line[TIPS["leap"]] = np.outer((1, 2, 3, 4), (0.03, 0.02, 0.01))
    with pytest.raises(DexFlexError, match="one line"):
        calibrate(LEAP, record(line))
    with pytest.raises(DexFlexError, match="`thumb_scale` must be positive"):
        calibrate(LEAP, record(), thumb_scale=0)
