import numpy as np

from lerobot_dexflex.hand.model import robot_joints
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.recording.schema import FPS, columns, privileged_columns, robot_type, rounded


def test_the_rate_of_datasets_is_the_control_rate():
    assert FPS == 20


def test_rounding_keeps_multiples_and_moves_others_by_at_most_half_a_step():
    rng = np.random.default_rng(0)
    for column in columns(robot_joints(LEAP)).values():
        values = rng.uniform(-1, 1, (50, len(column.names)))
        kept = rounded(values, column.steps)
        assert kept.dtype == np.float32
        assert (np.abs(kept - values) <= column.steps / 2).all()
        np.testing.assert_array_equal(rounded(kept, column.steps), kept)


def test_the_resolution_is_finer_than_a_tenth_millimetre_and_a_hundredth_degree():
    action = columns(robot_joints(LEAP))["action"]
    assert (action.steps[:23] < np.radians(0.01)).all()
    assert (action.steps[23:] < 1e-4).all()


def test_the_hand_alone_has_16_joints_and_no_arm_names():
    table = columns(LEAP.joint_names)
    assert len(table["observation.state"].names) == 16
    assert len(table["action"].names) == 16 + 12
    assert not any(name.startswith("joint") for name in table["action"].names)
    assert (robot_type(robot_joints(LEAP)), robot_type(LEAP.joint_names)) == ("leap_xarm7", "leap")


def test_taxels_are_named_in_the_order_of_the_flat_array():
    names = np.array(columns(robot_joints(LEAP))["observation.tactile"].names).reshape(4, 10, 6)
    assert names[0, 0, 0] == "if_taxel.0.0"
    assert names[3, 9, 5] == "th_taxel.9.5"
    assert names[1, 2, 4] == "mf_taxel.2.4"


def test_privileged_columns_are_named_apart_from_what_policies_get():
    table = privileged_columns()
    assert {key: len(column.names) for key, column in table.items()} == {
        "operator.draft": 12,
        "contact.loads": 4,
    }
    assert not table.keys() & columns(robot_joints(LEAP)).keys()
    assert not any(key.startswith(("observation", "action")) for key in table)
    assert table["contact.loads"].names == ["if_load", "mf_load", "rf_load", "th_load"]
    assert all("privileged" in column.meaning for column in table.values())
