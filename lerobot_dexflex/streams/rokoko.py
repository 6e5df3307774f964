"""Rokoko Studio's JSON v3, as gloves send it by UDP, one datagram per frame, in an LZ4 frame or not.

Metres, absolute; Y up, Z forward and X right, so left-handed. The vendor says nothing of X, but its plugin
for Unity takes it so, and in a public capture a person whose toes are at +z has the left arm at -x. There
`version` is the text "3,0", a hand without a glove has no fingers, and what is not known is at (0, 0, 0).

Sources: support.rokoko.com 4410416376977 and attachment 41280345093777; Rokoko/rokoko-studio-live-unity
`JsonLiveSerializerV3.cs`, `RokokoHelper.cs`; the capture is jack-z36/Dexhit's `captured_left_glove_v3.json`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

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

PORT = 14043
"""UDP port that Studio sends to unless told otherwise."""
POINT_NAMES = (
    "Hand",
    *(
        f"{finger}{bone}"
        for finger in ("Thumb", "Index", "Middle", "Ring", "Little")
        for bone in ("Proximal", "Medial", "Distal", "Tip")
    ),
)
"""Joints of a hand, behind `right` or `left`, in the order of `KEYPOINT_NAMES`."""
_WORLD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""X right, Y up, Z forward to x forward, y left, z up."""


@dataclass(frozen=True)
class RokokoReader:
    """Reads one hand of one person; see `Reader`.

    Lost is a hand if the scene is empty, its person has no body, or a point of its palm is null or (0, 0, 0).

    Raises:
        DexFlexError: If `hand` is none.
    """

    hand: Side = "right"
    mirror: bool = False
    """See `record_of`."""
    actor: str = ""
    """Name of the person; may be empty if the scene has one only."""
    trust_wrist: bool = False
    """Whether the wrist's pose counts although `meta.hasBody` is false: gloves alone do not measure where the
    hand is, and Studio sends a guess."""

    def __post_init__(self) -> None:
        check_hand(self.hand)

    def read(self, data: Packet) -> Record:
        """Return what a packet says of the hand.

        Args:
            data: A datagram, or its JSON object.

        Raises:
            PacketError: If it is malformed, of another version, or lacks the actor, gloves, hand or joints.
            DexFlexError: If it is compressed and lz4 is not installed.
        """
        scene = _scene(decoded(data))
        t = as_time(scene.get("timestamp"), "scene.timestamp")
        actor = self._actor(
            [as_mapping(actor, "an actor") for actor in as_sequence(scene.get("actors"), "scene.actors")]
        )
        if actor is None or actor.get("body") is None:
            return Record.lost(t)
        meta = as_mapping(actor.get("meta"), "meta")
        self._check_gloves(meta)
        found = self._points(as_mapping(actor["body"], "body"))
        measured = bool(meta.get("hasBody")) or self.trust_wrist
        return record_of(t, found @ _WORLD.T, self.hand, mirror=self.mirror, wrist_tracked=measured)

    def _actor(self, actors: list[Mapping[str, Any]]) -> Mapping[str, Any] | None:
        """Return the person; None if the scene is empty."""
        names = [str(actor.get("name")) for actor in actors]
        if not actors:
            return None
        if not self.actor and len(actors) == 1:
            return actors[0]
        if names.count(self.actor) != 1:
            raise PacketError("actor", f"`actor` must be one of {', '.join(names)}. Got {self.actor!r}.")
        return actors[names.index(self.actor)]

    def _check_gloves(self, meta: Mapping[str, Any]) -> None:
        worn = [hand for hand in ("right", "left") if meta.get(f"has{hand.title()}Glove")]
        if not worn:
            raise PacketError(
                "gloves",
                "The person wears no glove (meta.hasLeftGlove, hasRightGlove). Connect it in Studio.",
            )
        if self.hand not in worn:
            raise PacketError(
                "hand",
                f"The person wears the {worn[0]} glove only: `hand` must be {worn[0]}. Got {self.hand}.",
            )

    def _points(self, body: Mapping[str, Any]) -> Array:
        """Return the keypoints as sent, NaN where lost. Shape (21, 3)."""
        names = [self.hand + name for name in POINT_NAMES]
        if missing := [name for name in names if name not in body]:
            raise PacketError(
                "joints",
                f"The body lacks {', '.join(missing)}. Let Studio send JSON v3 with all finger joints.",
            )
        found = as_points([_position(body[name], name) for name in names], "position")
        return np.where((found == 0).all(1, keepdims=True), np.nan, found)


def _scene(packet: Mapping[str, Any]) -> Mapping[str, Any]:
    version = packet.get("version")
    # What Studio calls JSON v2.5 has version 3 and no scene.
    if str(version).replace(",", ".").partition(".")[0] != "3" or "scene" not in packet:
        raise PacketError(
            "version",
            f"The packet must be JSON v3. Got version {str(version)[:20]!r}; choose JSON v3 in Studio.",
        )
    return as_mapping(packet["scene"], "scene")


def _position(joint: Any, name: str) -> Array | None:
    place = None if joint is None else as_mapping(joint, name).get("position")
    if place is None:
        return None
    axes = [as_mapping(place, f"{name}.position").get(axis) for axis in "xyz"]
    return None if None in axes else as_numbers(axes, 3, f"{name}.position")
