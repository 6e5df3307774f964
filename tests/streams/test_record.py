"""A record is checked when it is made, and cannot change afterwards."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_hand import HAND, LEFTWARD, PLACE

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.record import HUMAN_TIPS, KEYPOINT_NAMES, Record


@pytest.fixture
def record():
    return Record(7.25, PLACE, LEFTWARD, HAND, np.ones(21, bool), True)


def test_points_have_mediapipes_names_and_numbers():
    assert len(KEYPOINT_NAMES) == 21
    assert [KEYPOINT_NAMES[k] for k in (0, 1, 5, 9, 13, 17)] == [
        "wrist",
        "thumb_cmc",
        "index_finger_mcp",
        "middle_finger_mcp",
        "ring_finger_mcp",
        "pinky_mcp",
    ]
    assert all(KEYPOINT_NAMES[k].endswith("_tip") for k in HUMAN_TIPS.values())
    assert {KEYPOINT_NAMES[k].split("_")[0]: k for k in HUMAN_TIPS.values()} == HUMAN_TIPS


def test_what_is_not_tracked_is_nan_whatever_was_said(record):
    tracked = np.arange(21) != 8
    part = replace(record, tracked=tracked, wrist_tracked=False)
    np.testing.assert_array_equal(np.isnan(part.keypoints).all(1), ~tracked)
    np.testing.assert_array_equal(part.keypoints[tracked], HAND[tracked])
    assert np.isnan(part.wrist_position).all()
    assert np.isnan(part.wrist_rotation).all()
    assert not part.is_lost


def test_a_lost_hand_is_a_record():
    lost = Record.lost(3.0)
    assert (lost.t, lost.is_lost, lost.wrist_tracked) == (3.0, True, False)
    assert not lost.tracked.any()


def test_a_record_does_not_change(record):
    points = HAND.copy()
    made = replace(record, keypoints=points)
    points[:] = 0
    np.testing.assert_array_equal(made.keypoints, HAND)
    for name in ("wrist_position", "wrist_rotation", "keypoints", "tracked"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(made, name)[0] = 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t": float("nan")}, "`t` must be a finite time"),
        ({"keypoints": HAND[:20]}, r"`keypoints` must have shape \(21, 3\). Got \(20, 3\)"),
        ({"tracked": np.ones(20, bool)}, r"`tracked` must have shape \(21,\)"),
        ({"wrist_position": [0.0, 1.0]}, r"`wrist_position` must have shape \(3,\)"),
        ({"wrist_rotation": [1.0, 0.0, 0.0, 0.0]}, r"`wrist_rotation` must have shape \(3, 3\)"),
        ({"keypoints": "hand"}, "`keypoints` must hold numbers"),
        ({"keypoints": np.where(np.arange(21)[:, None] == 8, np.inf, HAND)}, "index_finger_tip are not"),
        ({"keypoints": 100 * HAND}, "within 0.4 m of the wrist. Got 18"),
        ({"wrist_position": [0.0, np.nan, 0.0]}, "`wrist_position` must be finite"),
        ({"wrist_rotation": 1.01 * np.eye(3)}, "`wrist_rotation` must be a rotation"),
        ({"wrist_rotation": np.diag([1.0, 1.0, -1.0])}, "right-handed"),
        ({"wrist_rotation": np.full((3, 3), np.nan)}, "`wrist_rotation` must be a rotation"),
    ],
)
def test_what_cannot_be_right_is_refused(record, change, message):
    with pytest.raises(DexFlexError, match=message):
        replace(record, **change)
