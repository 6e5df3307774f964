"""Whatever arrives, a reader makes a record of it or refuses it; nothing else escapes."""

import numpy as np
import pytest
from synthetic_hand import (
    HAND,
    before_camera,
    broken_copies,
    in_world,
    mediapipe_packet,
    openxr_packet,
    rokoko_packet,
    sent,
)

from lerobot_dexflex.streams.mediapipe import MediaPipeReader
from lerobot_dexflex.streams.openxr import OpenXRReader
from lerobot_dexflex.streams.packets import LZ4_MAGIC, PacketError
from lerobot_dexflex.streams.rokoko import RokokoReader

FORMATS = [
    pytest.param(RokokoReader(), rokoko_packet(in_world(HAND)), id="rokoko"),
    pytest.param(OpenXRReader(), openxr_packet(in_world(HAND, np.eye(3))), id="openxr"),
    pytest.param(MediaPipeReader(), mediapipe_packet({"Right": before_camera(HAND)}), id="mediapipe"),
]


def outcome(reader, data):
    """Return `read`, `lost`, or the reason of a refusal."""
    try:
        record = reader.read(data)
    except PacketError as error:
        return error.reason
    return "lost" if record.is_lost else "read"


@pytest.mark.parametrize(("reader", "packet"), FORMATS)
def test_a_packet_with_a_broken_part_is_read_without_it_or_refused(reader, packet):
    outcomes = [outcome(reader, broken) for broken in broken_copies(packet)]
    assert {"read", "lost", "malformed"} <= set(outcomes)


@pytest.mark.parametrize(("reader", "packet"), FORMATS)
def test_a_packet_that_was_cut_off_is_malformed(reader, packet):
    data = sent(packet)
    assert outcome(reader, data) == "read"
    assert {outcome(reader, data[:k]) for k in range(0, len(data), 7)} == {"malformed"}


@pytest.mark.parametrize(("reader", "packet"), FORMATS)
def test_packets_with_flipped_bits_never_raise_anything_else(reader, packet):
    rng = np.random.default_rng(0)
    for _ in range(200):
        data = bytearray(sent(packet))
        for k in rng.integers(len(data), size=3):
            data[k] ^= 1 << int(rng.integers(8))
        outcome(reader, bytes(data))


@pytest.mark.parametrize(
    "data", [b"", b"\0" * 60, LZ4_MAGIC, b"[" * 10**6, b'{"a":' * 10**5, b"1" * 10**4, b"NaN"]
)
def test_what_is_no_packet_at_all_is_malformed(data):
    assert {outcome(parameters.values[0], data) for parameters in FORMATS} == {"malformed"}
