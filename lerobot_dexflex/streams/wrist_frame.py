"""The frame of the wrist, the same for all devices: made of points of the palm, which bends least.

Origin at the wrist; x toward the knuckle of the middle finger; y in the palm's plane, toward the index of a
right hand, away from that of a left one; z = x cross y, out of the back of either. The robot's palm frame has
these directions, too: an open hand retargets with little rotation.
"""

from typing import NamedTuple

import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.packets import PacketError
from lerobot_dexflex.streams.record import HUMAN_TIPS, KEYPOINT_NAMES, Array, Record, Side

WRIST, INDEX, MIDDLE, RING = (
    KEYPOINT_NAMES.index(name)
    for name in ("wrist", "index_finger_mcp", "middle_finger_mcp", "ring_finger_mcp")
)
_FLAT = 1e-3
"""Points of a palm that are nearer to each other, or to one line, span no frame [m]."""
_MIRROR = np.array([1.0, -1.0, 1.0])


class Frame(NamedTuple):
    """A pose in the world."""

    position: Array
    """[m]. Shape (3,)."""
    rotation: Array
    """Axes as columns. Shape (3, 3)."""


def wrist_frame(points: Array, hand: Side = "right") -> Frame | None:
    """Return the frame of a wrist; None if a point of the palm is lost, or they lie in one line.

    Args:
        points: Keypoints in any right-handed frame [m]; NaN where lost. Shape (21, 3).
        hand: Whose they are.
    """
    forward, across = points[MIDDLE] - points[WRIST], points[INDEX] - points[RING]
    length = np.linalg.norm(forward)
    if not length > _FLAT:
        return None
    x = forward / length
    back = np.cross(x, across if hand == "right" else -across)
    width = np.linalg.norm(back)
    if not width > _FLAT:
        return None
    z = back / width
    return Frame(points[WRIST], np.stack([x, np.cross(z, x), z], axis=1))


def record_of(
    t: float, points: Array, hand: Side = "right", *, mirror: bool = False, wrist_tracked: bool = True
) -> Record:
    """Return the record of keypoints; of a lost hand if its palm spans no frame.

    Args:
        t: The sender's clock [s].
        points: Keypoints in the world [m]; NaN where lost. Shape (21, 3).
        hand: Whose they are.
        mirror: Whether to mirror the keypoints at the wrist frame's x-z plane: a left hand becomes a right
            one. The wrist's pose stays: the robot's palm looks where the operator's does.
        wrist_tracked: Whether the pose of the wrist means something.

    Raises:
        PacketError: If the points are no hand.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # Nonsense is refused all the same.
        frame = wrist_frame(points, hand)
        if frame is None:
            return Record.lost(t)
        keypoints = (points - frame.position) @ frame.rotation
        tracked = np.all(np.isfinite(points), axis=1)
        try:
            return Record(t, *frame, keypoints * _MIRROR if mirror else keypoints, tracked, wrist_tracked)
        except DexFlexError as error:
            raise PacketError("malformed", str(error)) from error


def flexion(keypoints: Array) -> float:
    """Return how far the fingertips are on the palm's side of the palm, on average [m].

    Bend the hand: below 0 means that it is the other hand, or that the device's axes were taken wrongly.

    Args:
        keypoints: Of a record. Shape (21, 3).
    """
    tips = [HUMAN_TIPS[name] for name in ("index", "middle", "ring")]
    return -float(np.nanmean(keypoints[tips, 2]))
