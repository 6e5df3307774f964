"""MediaPipe's landmarks: no camera turns the wrist frame, and labels are as true as the image."""

from types import SimpleNamespace

import numpy as np
import pytest
from synthetic_hand import HAND, LEFT_HAND, before_camera, in_world, mediapipe_packet, sent

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams import mediapipe
from lerobot_dexflex.streams.mediapipe import MediaPipeReader
from lerobot_dexflex.streams.packets import PacketError
from lerobot_dexflex.streams.wrist_frame import flexion

RIGHT, LEFT = before_camera(HAND), before_camera(LEFT_HAND)
FLIPPED = (-1, 1, 1)
"""What a flipped image does to landmarks."""


def test_landmarks_of_a_palm_held_to_the_camera():
    record = MediaPipeReader().read(sent(mediapipe_packet({"Right": RIGHT})))
    assert record.t == 7.25
    np.testing.assert_allclose(record.keypoints, HAND, atol=1e-12)
    assert record.tracked.all()
    assert not record.wrist_tracked


def test_a_palm_held_to_the_camera_bends_toward_it():
    """The premise of the synthetic packet: tips are nearer to the camera (z smaller) than knuckles."""
    assert (RIGHT[[8, 12, 16], 2] < RIGHT[[5, 9, 13], 2]).all()
    assert (RIGHT[[8, 12, 16], 1] < RIGHT[[5, 9, 13], 1]).all()  # Fingers up.
    assert flexion(MediaPipeReader().read(mediapipe_packet({"Right": RIGHT})).keypoints) > 0


def test_keypoints_do_not_depend_on_the_camera():
    q, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    turned = in_world(RIGHT, q * np.linalg.det(q), (0, 0, 0))
    record = MediaPipeReader().read(mediapipe_packet({"Right": turned}))
    np.testing.assert_allclose(record.keypoints, HAND, atol=1e-12)


@pytest.mark.parametrize(
    ("flipped", "labels", "label"),
    [
        (False, "subject", "Right"),
        (True, "subject", "Left"),
        (True, "selfie", "Right"),
        (False, "selfie", "Left"),
    ],
)
def test_the_right_hand_is_found_under_the_label_that_it_gets(flipped, labels, label):
    other = {"Right": "Left", "Left": "Right"}[label]
    seen = {label: RIGHT, other: LEFT}
    packet = mediapipe_packet({name: points * (FLIPPED if flipped else 1) for name, points in seen.items()})
    right = MediaPipeReader(mirrored_image=flipped, labels=labels).read(packet)
    np.testing.assert_allclose(right.keypoints, HAND, atol=1e-12)
    left = MediaPipeReader(hand="left", mirrored_image=flipped, labels=labels).read(packet)
    np.testing.assert_allclose(left.keypoints, LEFT_HAND, atol=1e-12)


def test_a_mirrored_left_hand_is_a_right_hand():
    record = MediaPipeReader(hand="left", mirror=True).read(mediapipe_packet({"Left": LEFT}))
    np.testing.assert_allclose(record.keypoints, HAND, atol=1e-12)


def test_no_hand_is_a_lost_hand_and_the_other_hand_is_a_refusal():
    lost = MediaPipeReader().read(sent(mediapipe_packet({})))
    assert lost.is_lost
    assert lost.t == 7.25
    with pytest.raises(
        PacketError, match=r"Only \['Left'\] is seen, and the right hand would be 'Right'"
    ) as caught:
        MediaPipeReader().read(mediapipe_packet({"Left": LEFT}))
    assert caught.value.reason == "hand"


def test_a_result_of_mediapipe_becomes_a_packet():
    point = [SimpleNamespace(x=x, y=y, z=z, visibility=0.0) for x, y, z in RIGHT.tolist()]
    label = SimpleNamespace(category_name="Right", score=0.98)
    result = SimpleNamespace(hand_world_landmarks=[point], handedness=[[label]], hand_landmarks=[])
    assert mediapipe.packet(result, 7250) == mediapipe_packet({"Right": RIGHT})


def test_unknown_labels_are_refused():
    with pytest.raises(DexFlexError, match="`labels` must be subject or selfie"):
        MediaPipeReader(labels="viewer")  # pyright: ignore[reportArgumentType]
