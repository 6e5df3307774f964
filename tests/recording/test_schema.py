import numpy as np
import pytest

from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import LEAP, SHARPA
from lerobot_dexflex.recording.schema import FPS, columns, privileged_columns, robot_type, rounded


def test_the_rate_of_datasets_is_the_control_rate():
    assert FPS == 20


def test_rounding_keeps_multiples_and_moves_others_by_at_most_half_a_step():
    rng = np.random.default_rng(0)
    for column in columns(LEAP, robot_joints(LEAP)).values():
        values = rng.uniform(-1, 1, (50, len(column.names)))
        kept = rounded(values, column.steps)
        assert kept.dtype == np.float32
        assert (np.abs(kept - values) <= column.steps / 2).all()
        np.testing.assert_array_equal(rounded(kept, column.steps), kept)


def test_the_resolution_is_finer_than_a_tenth_millimetre_and_a_hundredth_degree():
    action = columns(LEAP, robot_joints(LEAP))["action"]
    assert (action.steps[:23] < np.radians(0.01)).all()
    assert (action.steps[23:] < 1e-4).all()


def test_the_hand_alone_has_16_joints_and_no_arm_names():
    table = columns(LEAP, LEAP.joint_names)
    assert len(table["observation.state"].names) == 16
    assert len(table["action"].names) == 16 + 12
    assert not any(name.startswith("joint") for name in table["action"].names)


@pytest.mark.parametrize("hand", [LEAP, SHARPA])
def test_the_robot_is_called_after_its_hand(hand):
    assert robot_type(hand, robot_joints(hand)) == f"{hand.name}_xarm7"
    assert robot_type(hand, hand.joint_names) == hand.name


def test_columns_have_the_sizes_of_the_hand():
    table = columns(SHARPA, robot_joints(SHARPA)) | privileged_columns(SHARPA)
    assert {key: len(column.names) for key, column in table.items()} == {
        "observation.state": 29,
        "observation.tactile": 300,
        "observation.fingertips": 15,
        "observation.gravity": 3,
        "action": 44,
        "operator.draft": 15,
        "contact.loads": 5,
    }
    assert table["contact.loads"].names[3:] == ["pinky_load", "thumb_load"]
    assert "5 fingers x 10 rows" in table["observation.tactile"].meaning


def test_taxels_are_named_in_the_order_of_the_flat_array():
    names = np.array(columns(LEAP, robot_joints(LEAP))["observation.tactile"].names).reshape(4, 10, 6)
    assert names[0, 0, 0] == "if_taxel.0.0"
    assert names[3, 9, 5] == "th_taxel.9.5"
    assert names[1, 2, 4] == "mf_taxel.2.4"


def test_privileged_columns_are_named_apart_from_what_policies_get():
    table = privileged_columns(LEAP)
    assert {key: len(column.names) for key, column in table.items()} == {
        "operator.draft": 12,
        "contact.loads": 4,
    }
    assert not table.keys() & columns(LEAP, robot_joints(LEAP)).keys()
    assert not any(key.startswith(("observation", "action")) for key in table)
    assert table["contact.loads"].names == ["if_load", "mf_load", "rf_load", "th_load"]
    assert all("privileged" in column.meaning for column in table.values())
