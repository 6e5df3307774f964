"""OpenXR's 26 hand joints (headsets, Manus gloves, Rokoko's SDK), named as IsaacTeleop's HandInput.

Metres, x right, y up, z backward, right-handed, in the space of the session. Quaternions are x y z w in both;
the wrist's y axis points out of the back of either hand, which tells the hands apart.

Sources: registry.khronos.org/OpenXR XrHandJointEXT and "Conventions of hand joints"; NVIDIA/IsaacTeleop
`tensor_types/standard_types.py`, issues 356 and 615.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.packets import (
    Packet,
    PacketError,
    as_mapping,
    as_numbers,
    as_points,
    as_sequence,
    as_time,
    check_hand,
    decoded,
)
from lerobot_dexflex.streams.record import Array, Record, Side
from lerobot_dexflex.streams.wrist_frame import record_of

Quaternions = Literal["xyzw", "wxyz"]

JOINT_NAMES = (
    "palm",
    "wrist",
    *(f"thumb_{joint}" for joint in ("metacarpal", "proximal", "distal", "tip")),
    *(
        f"{finger}_{joint}"
        for finger in ("index", "middle", "ring", "little")
        for joint in ("metacarpal", "proximal", "intermediate", "distal", "tip")
    ),
)
"""XrHandJointEXT, 0 to 25."""
_DROPPED = ("palm", *(f"{finger}_metacarpal" for finger in ("index", "middle", "ring", "little")))
KEPT = [k for k, name in enumerate(JOINT_NAMES) if name not in _DROPPED]
"""Joints that are keypoints. A joint is called by the bone that begins there: a finger's `proximal` is
its mcp, the thumb's `metacarpal` its cmc."""
_WORLD = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""X right, Y up, Z backward to x forward, y left, z up."""


@dataclass(frozen=True)
class OpenXRReader:
    """Reads one hand of `{"timestamp", "hand_right", "hand_left"}`; see `Reader`.

    Lost is a hand that is None or not active, and a joint that is None or not valid.

    Raises:
        DexFlexError: If `hand` or `quaternions` is none of those that there are.
    """

    hand: Side = "right"
    mirror: bool = False
    """See `record_of`."""
    quaternions: Quaternions = "xyzw"
    """Order of the numbers of `joint_orientations`."""

    def __post_init__(self) -> None:
        check_hand(self.hand)
        if self.quaternions not in ("xyzw", "wxyz"):
            raise DexFlexError(f"`quaternions` must be xyzw or wxyz. Got {self.quaternions!r}.")

    def read(self, data: Packet) -> Record:
        """Return what a packet says of the hand.

        Args:
            data: JSON or a mapping: `timestamp` (XrTime) [ns]; each hand None, or `joint_positions` [m] of
                shape (26, 3) and, if sent, `joint_orientations` (26, 4), `joint_valid` (26,), `is_active`.

        Raises:
            PacketError: If it is malformed, or holds only the other hand or an impossible one.
            DexFlexError: If it is compressed and lz4 is not installed.
        """
        packet = decoded(data)
        t = as_time(packet.get("timestamp"), "timestamp", 1e-9)
        key = f"hand_{self.hand}"
        if key not in packet:
            held = [name for name in packet if str(name).startswith("hand_")]
            raise PacketError("hand", f"The packet must hold {key}. Got {held}: see `hand`.")
        if packet[key] is None:
            return Record.lost(t)
        joints = as_mapping(packet[key], key)
        if not joints.get("is_active", True):
            return Record.lost(t)
        record = record_of(t, _positions(joints)[KEPT] @ _WORLD.T, self.hand, mirror=self.mirror)
        self._check_side(record, joints)
        return record

    def _check_side(self, record: Record, joints: Mapping[str, Any]) -> None:
        """Refuse points whose back is where the wrist's orientation has the palm."""
        if joints.get("joint_orientations") is None:
            return
        rows = as_sequence(joints["joint_orientations"], "joint_orientations", len(JOINT_NAMES))
        [turn] = as_points([rows[JOINT_NAMES.index("wrist")]], "an orientation", 4)
        if not np.isclose(np.linalg.norm(turn), 1, atol=0.01):
            return  # Unknown: None, or zeros.
        x, y, z, w = turn if self.quaternions == "xyzw" else np.roll(turn, -1)
        back = _WORLD @ [2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)]
        if record.wrist_rotation[:, 2] @ back < 0:
            raise PacketError(
                "hand", "The wrist's orientation says that this is the other hand: see `hand`, `quaternions`."
            )


def _positions(joints: Mapping[str, Any]) -> Array:
    """Return the joints as sent, NaN where lost. Shape (26, 3)."""
    count = len(JOINT_NAMES)
    found = as_points(as_sequence(joints.get("joint_positions"), "joint_positions", count), "a joint")
    if joints.get("joint_valid") is not None:
        found[as_numbers(joints["joint_valid"], count, "joint_valid") == 0] = np.nan
    return found
