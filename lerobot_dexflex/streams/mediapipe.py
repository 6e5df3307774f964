"""MediaPipe's hand landmarks: 21 points of a camera image, in metres around the middle of the hand.

World landmarks are x right and y down in the image, z away from the camera: right-handed unless the image was
flipped. They do not say where the hand is, so the wrist is not tracked.

Sources: HandLandmarkerResult, ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker; that its labels
changed sides between 0.10.0 and 0.10.15, google-ai-edge/mediapipe-samples#450.
"""

from dataclasses import dataclass
from typing import Any, Literal

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.packets import (
    Packet,
    PacketError,
    as_points,
    as_sequence,
    as_time,
    check_hand,
    decoded,
)
from lerobot_dexflex.streams.record import KEYPOINTS, Record, Side
from lerobot_dexflex.streams.wrist_frame import record_of

Labels = Literal["subject", "selfie"]


@dataclass(frozen=True)
class MediaPipeReader:
    """Reads one hand of `{"timestamp_ms", "handedness", "hand_world_landmarks"}`; see `Reader` and `packet`.

    Of two hands with the same label the first counts. Lost is a hand if no hand is seen.

    Raises:
        DexFlexError: If `hand` or `labels` is none of those that there are.
    """

    hand: Side = "right"
    mirror: bool = False
    """See `record_of`."""
    mirrored_image: bool = False
    """Whether the image was flipped, like a selfie, before the hand was looked for."""
    labels: Labels = "subject"
    """For which images `handedness` names the person's hand: `subject`, as today, for those that were not
    flipped; `selfie`, as in `mp.solutions.hands` and early versions of the task, for those that were."""

    def __post_init__(self) -> None:
        check_hand(self.hand)
        if self.labels not in ("subject", "selfie"):
            raise DexFlexError(f"`labels` must be subject or selfie. Got {self.labels!r}.")

    def read(self, data: Packet) -> Record:
        """Return what a packet says of the hand.

        Args:
            data: JSON or a mapping: `timestamp_ms` [ms], `handedness`: Left or Right per hand,
                `hand_world_landmarks`: 21 triples [m] per hand.

        Raises:
            PacketError: If it is malformed, or shows only the other hand.
            DexFlexError: If it is compressed and lz4 is not installed.
        """
        packet = decoded(data)
        t = as_time(packet.get("timestamp_ms"), "timestamp_ms", 1e-3)
        labels = [str(label) for label in as_sequence(packet.get("handedness"), "handedness")]
        hands = as_sequence(packet.get("hand_world_landmarks"), "hand_world_landmarks", len(labels))
        if not labels:
            return Record.lost(t)
        wanted = self._label()
        if wanted not in labels:
            raise PacketError(
                "hand",
                f"Only {labels} is seen, and the {self.hand} hand would be {wanted!r}: see `hand`, `labels`.",
            )
        rows = as_sequence(hands[labels.index(wanted)], "a hand's landmarks", KEYPOINTS)
        found = as_points(rows, "a landmark") * ((-1 if self.mirrored_image else 1), 1, 1)
        return record_of(t, found, self.hand, mirror=self.mirror, wrist_tracked=False)

    def _label(self) -> str:
        """Return how MediaPipe calls the hand."""
        right = (self.hand == "right") != (self.mirrored_image != (self.labels == "selfie"))
        return "Right" if right else "Left"


def packet(result: Any, timestamp_ms: int) -> dict[str, Any]:
    """Return what to read, or to send as JSON, of a `HandLandmarkerResult`.

    Args:
        result: MediaPipe's.
        timestamp_ms: Of its image.
    """
    hands = [[[point.x, point.y, point.z] for point in hand] for hand in result.hand_world_landmarks]
    labels = [categories[0].category_name for categories in result.handedness]
    return {"timestamp_ms": timestamp_ms, "handedness": labels, "hand_world_landmarks": hands}
