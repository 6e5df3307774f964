import socket
import time

import numpy as np
import pytest
from moving_hand import record
from synthetic_hand import (
    HAND,
    LEFT_HAND,
    before_camera,
    in_world,
    mediapipe_packet,
    openxr_packet,
    rokoko_packet,
    sent,
)

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.files import RecordWriter, read_records
from lerobot_dexflex.teleop.sources import StoredReceiver, open_source
from lerobot_dexflex.teleop.stream_config import StreamConfig

LOCAL = {"host": "127.0.0.1", "port": 0}


def received(source, packet):
    """Send a packet to a source; return the newest record."""
    port = getattr(source, "_receiver", source).port
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(sent(packet), ("127.0.0.1", port))
    until = time.monotonic() + 2.0
    while (newest := source.newest(time.monotonic())).record is None and source.refusal is None:
        assert time.monotonic() < until
        time.sleep(0.01)
    return newest


def time_of(source, now):
    """Return the time of the newest record [s]."""
    record = source.newest(now).record
    return None if record is None else record.t


@pytest.mark.parametrize(
    ("name", "packet", "wrist"),
    [
        ("rokoko", rokoko_packet(in_world(HAND)), True),
        ("openxr", openxr_packet(in_world(HAND)), True),
        ("mediapipe", mediapipe_packet({"Right": before_camera(HAND)}), False),
    ],
)
def test_every_format_is_received(name, packet, wrist):
    with open_source(name, StreamConfig(**LOCAL)) as source:
        newest = received(source, packet)
    assert newest.record is not None
    assert newest.record.wrist_tracked == wrist
    np.testing.assert_allclose(newest.record.keypoints, HAND, atol=1e-3)


def test_a_left_hand_is_mirrored_for_the_robots_right_one():
    with open_source("openxr", StreamConfig(hand="left", **LOCAL)) as source:
        newest = received(source, openxr_packet(in_world(LEFT_HAND), hand="left"))
    assert newest.record is not None
    np.testing.assert_allclose(newest.record.keypoints, HAND, atol=1e-6)


def test_settings_reach_the_reader():
    packet = rokoko_packet(in_world(HAND), hasBody=False)
    with open_source("rokoko", StreamConfig(trust_wrist=True, actor="Ann", **LOCAL)) as source:
        newest = received(source, packet)
    assert newest.record is not None
    assert newest.record.wrist_tracked


def test_what_comes_is_stored_once_and_can_be_replayed(tmp_path):
    config = StreamConfig(save=tmp_path / "hand.jsonl", **LOCAL)
    with open_source("rokoko", config) as source:
        for t in (1.0, 1.01, 1.02):
            received(source, rokoko_packet(in_world(HAND), t=t))
            while time_of(source, time.monotonic()) != t:
                time.sleep(0.005)
    stored = read_records(tmp_path / "hand.jsonl")
    assert [one.t for one in stored.records] == [1.0, 1.01, 1.02]
    with open_source("replay", StreamConfig(file=tmp_path / "hand.jsonl")) as source:
        assert time_of(source, 5.0) == 1.0
        assert time_of(source, 5.015) == 1.01


def test_why_a_packet_is_refused_can_be_asked_while_it_is_stored(tmp_path):
    with open_source("rokoko", StreamConfig(save=tmp_path / "hand.jsonl", **LOCAL)) as source:
        received(source, rokoko_packet(in_world(LEFT_HAND), hand="left"))
        assert isinstance(source, StoredReceiver)
        assert "wears the left glove only" in str(source.refusal)


@pytest.mark.parametrize(
    ("source", "settings", "message"),
    [
        ("rokoko", {"hand": "both"}, "`hand` must be right or left. Got 'both'"),
        ("rokoko", {"port": 70000}, r"`port` must be in \[0, 65535\]"),
        ("rokoko", {"labels": "selfie"}, "--source=rokoko does not read --stream.labels"),
        ("replay", {}, "--source=replay needs --stream.file"),
        ("replay", {"file": "x", "port": 1}, "does not read --stream.port. It reads: --stream.file."),
        ("simulated", {"port": 1}, "does not read --stream.port. It reads: none."),
    ],
)
def test_settings_that_a_source_does_not_read_are_refused(source, settings, message):
    with pytest.raises(DexFlexError, match=message):
        StreamConfig(**settings).check(source)


def test_settings_of_a_reader_and_files_are_checked(tmp_path):
    with pytest.raises(DexFlexError, match="`quaternions` must be xyzw or wxyz"):  # noqa: SIM117
        with open_source("openxr", StreamConfig(quaternions="zyx", **LOCAL)):
            pass
    with pytest.raises(DexFlexError, match="cannot be read"):  # noqa: SIM117
        with open_source("replay", StreamConfig(file=tmp_path / "none")):
            pass
    with RecordWriter(tmp_path / "hand.jsonl") as writer:
        writer.append(record(0.0))
    with pytest.raises(DexFlexError, match="cannot be made"):  # noqa: SIM117
        with open_source("rokoko", StreamConfig(save=tmp_path / "hand.jsonl", **LOCAL)):
            pass
