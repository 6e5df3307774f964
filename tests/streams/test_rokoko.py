"""Studio's JSON v3: where points end up, and what each kind of bad packet leads to."""

import sys

import lz4.frame
import numpy as np
import pytest
from synthetic_hand import (
    HAND,
    LEFT_HAND,
    LEFTWARD,
    PLACE,
    ROKOKO_NAMES,
    in_world,
    rokoko_packet,
    sent,
)

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.packets import PacketError
from lerobot_dexflex.streams.record import KEYPOINT_NAMES
from lerobot_dexflex.streams.rokoko import POINT_NAMES, RokokoReader
from lerobot_dexflex.streams.wrist_frame import flexion

PACKET = rokoko_packet(in_world(HAND))


def changed(**changes):
    """Return the packet with other values in its only person."""
    packet = rokoko_packet(in_world(HAND))
    packet["scene"]["actors"][0] |= changes
    return packet


def without(*names):
    body = {name: joint for name, joint in PACKET["scene"]["actors"][0]["body"].items() if name not in names}
    return changed(body=body)


def refusal(packet, **settings):
    with pytest.raises(PacketError) as caught:
        RokokoReader(**settings).read(packet)
    return caught.value.reason


def test_a_hand_before_the_chest_is_where_it_is():
    """By hand: 40 cm before the person, 30 cm to the right, 1.2 m high, fingers to the left, back up."""
    joints = {"rightHand": (0.3, 1.2, 0.4), "rightMiddleProximal": (0.21, 1.2, 0.4)}
    joints |= {"rightIndexProximal": (0.212, 1.2, 0.378), "rightRingProximal": (0.217, 1.2, 0.42)}
    packet = rokoko_packet(np.full((21, 3), np.nan))
    body = packet["scene"]["actors"][0]["body"]
    for name, (x, y, z) in joints.items():
        body[name]["position"] = {"x": x, "y": y, "z": z}
    record = RokokoReader().read(sent(packet))
    assert record.t == 7.25
    np.testing.assert_allclose(record.wrist_position, (0.4, -0.3, 1.2))
    # The thumb's side of a right hand with its back up and fingers to the left is the person's.
    np.testing.assert_allclose(record.wrist_rotation.T, [(0, 1, 0), (-1, 0, 0), (0, 0, 1)], atol=1e-12)
    np.testing.assert_allclose(record.keypoints[9], (0.09, 0, 0), atol=1e-12)
    np.testing.assert_allclose(record.keypoints[5], (0.088, 0.022, 0), atol=1e-12)
    assert record.tracked.sum() == 4


def test_points_come_in_mediapipes_order():
    record = RokokoReader().read(sent(PACKET))
    np.testing.assert_allclose(record.keypoints, HAND, atol=1e-12)
    np.testing.assert_allclose(record.wrist_rotation, LEFTWARD, atol=1e-12)
    assert record.wrist_tracked
    assert list(POINT_NAMES) == ROKOKO_NAMES
    bones = {"mcp": "Proximal", "pip": "Medial", "dip": "Distal", "tip": "Tip"}
    fingers = {"index_finger": "Index", "middle_finger": "Middle", "ring_finger": "Ring", "pinky": "Little"}
    for name, studio in list(zip(KEYPOINT_NAMES, POINT_NAMES, strict=True))[5:]:
        finger, bone = name.rsplit("_", 1)
        assert fingers[finger] + bones[bone] == studio


def test_axes_are_left_handed_so_that_a_hand_bends_toward_its_palm():
    assert flexion(RokokoReader().read(PACKET).keypoints) > 0
    flipped = rokoko_packet(in_world(HAND) * (1, -1, 1))
    assert flexion(RokokoReader().read(flipped).keypoints) < 0


@pytest.mark.parametrize("version", ["3,0", "3.0", "3", 3, 3.0])
def test_all_spellings_of_the_version_are_read(version):
    assert not RokokoReader().read(PACKET | {"version": version}).is_lost


def test_a_compressed_packet_says_the_same():
    plain, packed = RokokoReader().read(sent(PACKET)), RokokoReader().read(lz4.frame.compress(sent(PACKET)))
    np.testing.assert_array_equal(plain.keypoints, packed.keypoints)
    assert plain.t == packed.t


def test_a_mirrored_left_hand_is_a_right_hand():
    packet = rokoko_packet(in_world(LEFT_HAND), "left")
    left = RokokoReader(hand="left").read(packet)
    np.testing.assert_allclose(left.keypoints, LEFT_HAND, atol=1e-12)
    mirrored = RokokoReader(hand="left", mirror=True).read(packet)
    np.testing.assert_allclose(mirrored.keypoints, HAND, atol=1e-12)
    np.testing.assert_allclose(mirrored.wrist_position, PLACE)


def test_gloves_without_a_body_do_not_know_where_the_wrist_is():
    packet = rokoko_packet(in_world(HAND), hasBody=False)
    record = RokokoReader().read(packet)
    assert not record.wrist_tracked
    np.testing.assert_allclose(record.keypoints, HAND, atol=1e-12)
    assert RokokoReader(trust_wrist=True).read(packet).wrist_tracked


ZERO = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}}


@pytest.mark.parametrize(
    "packet",
    [
        PACKET | {"scene": {"timestamp": 7.25, "actors": []}},
        changed(body=None),
        changed(body={"right" + name: None for name in ROKOKO_NAMES}),
        changed(body={"right" + name: ZERO for name in ROKOKO_NAMES}),
    ],
    ids=["nobody", "no body", "null joints", "joints at zero"],
)
def test_a_lost_hand_is_a_record(packet):
    record = RokokoReader().read(sent(packet))
    assert record.is_lost
    assert record.t == 7.25


@pytest.mark.parametrize(
    "joint", [None, ZERO, {"position": None}, {"position": {"x": float("nan"), "y": 0, "z": 0}}]
)
def test_a_lost_joint_is_lost_alone(joint):
    packet = rokoko_packet(in_world(HAND))
    packet["scene"]["actors"][0]["body"]["rightRingTip"] = joint
    record = RokokoReader().read(sent(packet))
    assert np.flatnonzero(~record.tracked).tolist() == [16]
    np.testing.assert_allclose(record.keypoints[record.tracked], HAND[record.tracked], atol=1e-12)


def test_every_other_fault_has_a_reason_of_its_own():
    assert refusal(b"{") == "malformed"
    assert refusal(b"[1, 2]") == "malformed"
    assert refusal(b"\xff\xfe\x00") == "malformed"
    assert refusal(PACKET | {"version": "2,0"}) == "version"
    assert refusal(PACKET | {"version": "30"}) == "version"
    assert refusal({"version": 3, "trackers": [], "actors": []}) == "version"  # JSON v2.5.
    assert refusal(changed(meta={"hasLeftGlove": False, "hasRightGlove": False})) == "gloves"
    assert refusal(PACKET, hand="left") == "hand"
    assert refusal(rokoko_packet(in_world(LEFT_HAND), "left")) == "hand"
    assert refusal(without("rightIndexTip")) == "joints"
    assert refusal(PACKET, actor="Bob") == "actor"


def test_refusals_say_what_is_there_and_what_to_do():
    with pytest.raises(PacketError, match=r"lacks rightIndexTip, rightLittleTip\..*all finger joints"):
        RokokoReader().read(without("rightIndexTip", "rightLittleTip"))
    with pytest.raises(PacketError, match="wears the right glove only: `hand` must be right"):
        RokokoReader(hand="left").read(PACKET)
    with pytest.raises(PacketError, match="Got version '2,0'"):
        RokokoReader().read(PACKET | {"version": "2,0"})


def test_one_of_several_people_must_be_named():
    packet = rokoko_packet(in_world(HAND))
    other = rokoko_packet(in_world(HAND, place=(0, 0, 0.9)))["scene"]["actors"][0] | {"name": "Bob"}
    packet["scene"]["actors"].append(other)
    assert refusal(packet) == "actor"
    assert RokokoReader(actor="Bob").read(packet).wrist_position[2] == pytest.approx(0.9)
    assert RokokoReader(actor="Ann").read(packet).wrist_position[2] == pytest.approx(1.2)


def test_damaged_compression_is_malformed():
    packed = lz4.frame.compress(sent(PACKET), content_checksum=True)
    assert refusal(packed[:-10]) == "malformed"
    assert refusal(packed[:4]) == "malformed"
    broken = bytearray(packed)
    broken[len(packed) // 2] ^= 255
    assert refusal(bytes(broken)) == "malformed"
    assert refusal(lz4.frame.compress(sent(PACKET).ljust(2**24 + 1))) == "malformed"
    assert not RokokoReader().read(lz4.frame.compress(sent(PACKET).ljust(2**24))).is_lost


def test_missing_lz4_is_said_and_not_taken_for_a_bad_packet(monkeypatch):
    monkeypatch.setitem(sys.modules, "lz4.frame", None)
    with pytest.raises(DexFlexError, match="pip install lz4") as caught:
        RokokoReader().read(lz4.frame.compress(sent(PACKET)))
    assert not isinstance(caught.value, PacketError)
    assert not RokokoReader().read(sent(PACKET)).is_lost


def test_an_unknown_hand_is_refused():
    with pytest.raises(DexFlexError, match="`hand` must be right or left"):
        RokokoReader(hand="both")  # pyright: ignore[reportArgumentType]
