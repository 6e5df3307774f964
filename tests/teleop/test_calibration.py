import numpy as np
import pytest
from moving_hand import MovingHand, bent, record
from synthetic_hand import HAND, LEFT_HAND

from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.streams.retarget import calibrate
from lerobot_dexflex.teleop.calibration import HELD, OpenHand

AT_THE_PALM = HAND.copy()
AT_THE_PALM[4] = (0.05, 0.0, -0.03)
"""A hand whose thumb lies across the palm."""


def watch(at, seconds=2.5, eyes=None):
    """Look at a hand at 50 Hz; return the retargeting, when it was found, and the complaint."""
    eyes, source = eyes or OpenHand(LEAP), MovingHand(at)
    for now in np.arange(0.0, seconds, 0.02).tolist():
        found = eyes.look(source.newest(now), now)
        if found is not None:
            return found, now, eyes.complaint
    return None, seconds, eyes.complaint


def shaken(t, size):
    rng = np.random.default_rng(round(1000 * t))
    return record(t, keypoints=HAND + rng.uniform(-size, size, HAND.shape))


def test_an_open_hand_that_is_held_still_is_fitted_after_a_second():
    found, now, _ = watch(lambda t: record(t, wrist=False))
    assert found is not None
    assert now == pytest.approx(HELD, abs=0.03)
    assert found.scale == pytest.approx(calibrate(LEAP, record(0.0)).scale)


def test_noise_is_averaged_out():
    found, _, _ = watch(lambda t: shaken(t, 0.002))
    assert found is not None
    exact = calibrate(LEAP, record(0.0)).offset
    single = [np.linalg.norm(calibrate(LEAP, shaken(t, 0.002)).offset - exact) for t in np.arange(0, 1, 0.1)]
    assert np.linalg.norm(found.offset - exact) < 0.3 * np.median(single)


def test_a_hand_that_moves_is_not_fitted():
    """5 cm/s: 1 cm in 0.2 s."""
    found, _, complaint = watch(lambda t: record(t, keypoints=HAND + 0.05 * t * np.array([1.0, 0, 0])))
    assert found is None
    assert complaint == ""


def test_the_second_counts_from_when_the_hand_is_still():
    found, now, _ = watch(lambda t: shaken(t, 0.02 if t < 0.6 else 0.0))
    assert found is not None
    assert now == pytest.approx(0.6 + HELD, abs=0.05)


@pytest.mark.parametrize(
    ("hand", "complaint"),
    [
        (bent(0.8), "The index finger is bent. Open the hand."),
        (AT_THE_PALM, "That is no open hand, it fits to 25 mm only. Spread the thumb."),
        (LEFT_HAND, "this is a left hand"),
    ],
)
def test_another_still_hand_is_told_what_is_wrong_with_it(hand, complaint):
    found, _, told = watch(lambda t: record(t, keypoints=hand))
    assert found is None
    assert complaint in told


def test_after_a_complaint_the_open_hand_is_fitted():
    found, now, _ = watch(lambda t: record(t, keypoints=bent(0.8) if t < 1.5 else HAND), seconds=4.0)
    assert found is not None
    assert now == pytest.approx(1.5 + HELD, abs=0.05)


@pytest.mark.parametrize(("lost", "fits"), [([20], True), ([7], False), ([4], False)])
def test_only_the_little_finger_may_be_lost(lost, fits):
    found, _, _ = watch(lambda t: record(t, lost=lost))
    assert (found is not None) == fits


def test_a_stream_that_stops_is_not_a_hand_that_is_still():
    found, _, _ = watch(lambda t: record(t) if t < 0.5 else None)
    assert found is None


@pytest.mark.parametrize(("lost", "fits"), [([], True), ([20], False)])
def test_a_hand_with_a_little_finger_wants_to_see_that_of_the_person(lost, fits):
    found, _, complaint = watch(lambda t: record(t, lost=lost), eyes=OpenHand(SHARPA))
    assert (found is not None) == fits
    assert complaint == ""
    if found is not None:
        assert found.hand is SHARPA
