"""OpenXR's 26 joints: which are kept, where they end up, and how a wrong hand is found out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_hand import HAND, LEFT_HAND, LEFTWARD, PLACE, in_world, openxr_packet, sent

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.openxr import JOINT_NAMES, OpenXRReader
from lerobot_dexflex.streams.packets import PacketError

FORWARD = np.eye(3)
TURNED = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
"""Of a hand with its back up whose fingers (-z of the joint) point left: a quarter turn about y, up."""
PALM_UP = np.diag([1.0, -1.0, -1.0])
ROLLED = (0.0, 0.0, 1.0, 0.0)
"""Half a turn about z: back down."""


def test_joints_are_those_of_the_standard():
    # XrHandJointEXT: the numbers of some enumerants.
    numbers = {
        "palm": 0,
        "wrist": 1,
        "thumb_tip": 5,
        "index_metacarpal": 6,
        "middle_tip": 15,
        "little_tip": 25,
    }
    assert {name: JOINT_NAMES.index(name) for name in numbers} == numbers
    assert len(JOINT_NAMES) == 26


@pytest.mark.parametrize(
    ("turn", "orientation"), [(FORWARD, (0, 0, 0, 1)), (LEFTWARD, TURNED), (PALM_UP, ROLLED)]
)
def test_points_and_wrist_are_where_they_are(turn, orientation):
    packet = openxr_packet(in_world(HAND, turn), orientation=orientation)
    record = OpenXRReader().read(sent(packet))
    assert record.t == pytest.approx(7.25)
    np.testing.assert_allclose(record.keypoints, HAND, atol=1e-12)
    np.testing.assert_allclose(record.wrist_position, PLACE)
    np.testing.assert_allclose(record.wrist_rotation, turn, atol=1e-12)


def test_a_hand_in_front_is_at_minus_z():
    """By hand: the wrist 40 cm ahead, 30 cm to the right, 1.2 m up is (0.3, 1.2, -0.4) in OpenXR."""
    packet = openxr_packet(in_world(HAND, FORWARD))
    assert packet["hand_right"]["joint_positions"][1] == pytest.approx((0.3, 1.2, -0.4))
    assert packet["hand_right"]["joint_positions"][12] == pytest.approx((0.3, 1.2, -0.49))


def test_arrays_and_json_say_the_same():
    packet = openxr_packet(in_world(HAND, FORWARD))
    arrays = packet | {"hand_right": {key: np.float32(value) for key, value in packet["hand_right"].items()}}
    np.testing.assert_allclose(
        OpenXRReader().read(arrays).keypoints, OpenXRReader().read(packet).keypoints, atol=1e-6
    )


def test_a_mirrored_left_hand_is_a_right_hand():
    packet = openxr_packet(in_world(LEFT_HAND, LEFTWARD), "left", orientation=TURNED)
    record = OpenXRReader(hand="left", mirror=True).read(packet)
    np.testing.assert_allclose(record.keypoints, HAND, atol=1e-12)


@pytest.mark.parametrize("hand", [None, {"is_active": False}])
def test_a_lost_hand_is_a_record(hand):
    record = OpenXRReader().read(sent({"timestamp": 7_250_000_000, "hand_right": hand}))
    assert record.is_lost
    assert record.t == pytest.approx(7.25)


def test_lost_joints_are_lost_alone():
    packet = openxr_packet(in_world(HAND, FORWARD))
    joints = packet["hand_right"]
    joints["joint_positions"][10] = None  # Index tip.
    joints["joint_valid"] = [k != 20 for k in range(26)]  # Ring tip.
    record = OpenXRReader().read(sent(packet))
    assert np.flatnonzero(~record.tracked).tolist() == [8, 16]
    joints["joint_positions"][1] = None
    assert OpenXRReader().read(packet).is_lost


def test_points_of_the_other_hand_are_found_out_by_the_wrists_orientation():
    """Nothing in the points tells a flat left hand from a right one, turned over."""
    packet = openxr_packet(in_world(LEFT_HAND, FORWARD))
    with pytest.raises(PacketError, match="other hand") as caught:
        OpenXRReader().read(packet)
    assert caught.value.reason == "hand"
    del packet["hand_right"]["joint_orientations"]
    assert not OpenXRReader().read(packet).is_lost


def orientation_of(turn):
    """Return the wrist joint's x y z w: x away from a right hand's index, y out of the back, z backward."""
    x, y, z = turn.T
    forward, left, up = np.stack([-y, z, -x], axis=1)  # Rows: what the joint's axes have of the world's.
    return Rotation.from_matrix([-left, up, -forward]).as_quat()


@pytest.mark.parametrize("quaternions", ["xyzw", "wxyz"])
def test_hands_are_told_apart_however_they_are_turned(quaternions):
    reader = OpenXRReader(quaternions=quaternions)
    for turn in Rotation.random(30, rng=np.random.default_rng(0)).as_matrix():
        orientation = np.roll(orientation_of(turn), 1 if quaternions == "wxyz" else 0)
        right = openxr_packet(in_world(HAND, turn), orientation=orientation)
        np.testing.assert_allclose(reader.read(right).wrist_rotation, turn, atol=1e-9)
        with pytest.raises(PacketError, match="other hand"):
            reader.read(openxr_packet(in_world(LEFT_HAND, turn), orientation=orientation))


def test_quaternions_in_another_order_are_found_out():
    packet = openxr_packet(in_world(HAND, PALM_UP), orientation=np.roll(ROLLED, 1))
    with pytest.raises(PacketError, match="quaternions"):
        OpenXRReader().read(packet)


def test_a_packet_of_the_other_hand_only_is_refused():
    with pytest.raises(PacketError, match=r"must hold hand_right. Got \['hand_left'\]") as caught:
        OpenXRReader().read(openxr_packet(in_world(LEFT_HAND, FORWARD), "left"))
    assert caught.value.reason == "hand"


def test_unknown_settings_are_refused():
    with pytest.raises(DexFlexError, match="`quaternions` must be xyzw or wxyz"):
        OpenXRReader(quaternions="zyxw")  # pyright: ignore[reportArgumentType]
    with pytest.raises(DexFlexError, match="`hand` must be"):
        OpenXRReader(hand="")  # pyright: ignore[reportArgumentType]
