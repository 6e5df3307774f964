"""Datagrams over the loopback, with a clock of our own: [s], ticks of 50 ms."""

import socket

import lz4.frame
import numpy as np
import pytest
from synthetic_hand import HAND, in_world, rokoko_packet, sent

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams import receiver as receiver_module
from lerobot_dexflex.streams.receiver import UdpReceiver
from lerobot_dexflex.streams.rokoko import RokokoReader


@pytest.fixture
def stream():
    """A receiver that has looked once, at 0 s, and a function that sends to it."""
    with (
        UdpReceiver(RokokoReader(), 0, "127.0.0.1") as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        assert receiver.newest(0.0) == (None, True)
        yield receiver, lambda data: sender.sendto(data, ("127.0.0.1", receiver.port))


def packet(t):
    return sent(rokoko_packet(in_world(HAND), t=t))


LOST = sent({"version": 3, "scene": {"timestamp": 7.0, "actors": []}})


def time_of(newest):
    return None if newest.record is None else newest.record.t


def test_the_newest_packet_counts_and_all_are_taken(stream):
    receiver, send = stream
    for t in (1.0, 1.01, 1.02):
        send(packet(t))
    newest = receiver.newest(0.05)
    assert (time_of(newest), newest.stale) == (1.02, False)
    np.testing.assert_allclose(newest.record.keypoints, HAND, atol=1e-12)
    assert (receiver.counts.received, receiver.counts.late) == (3, 0)
    assert time_of(receiver.newest(0.1)) == 1.02


def test_packets_that_overtake_each_other_are_late(stream):
    receiver, send = stream
    for t in (1.0, 1.02, 1.01):
        send(packet(t))
    assert time_of(receiver.newest(0.05)) == 1.02
    send(packet(1.015))
    assert time_of(receiver.newest(0.1)) == 1.02
    assert (receiver.counts.received, receiver.counts.late) == (4, 2)


def test_a_late_packet_does_not_make_the_stream_look_alive(stream):
    receiver, send = stream
    send(packet(1.0))
    receiver.newest(0.05)
    send(packet(0.9))
    receiver.newest(0.1)
    assert receiver.newest(0.16).stale


def test_a_record_is_stale_after_100_ms(stream):
    receiver, send = stream
    send(packet(1.0))
    assert not receiver.newest(0.05).stale
    assert not receiver.newest(0.149).stale
    newest = receiver.newest(0.151)
    assert newest.stale
    assert time_of(newest) == 1.0
    send(packet(1.1))
    assert not receiver.newest(0.2).stale


def test_what_waited_through_a_pause_is_stale(stream):
    receiver, send = stream
    send(packet(1.0))
    newest = receiver.newest(3.0)
    assert (time_of(newest), newest.stale) == (1.0, True)
    send(packet(4.0))
    assert not receiver.newest(3.05).stale


def test_what_waited_before_the_first_look_is_stale():
    with (
        UdpReceiver(RokokoReader(), 0, "127.0.0.1") as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        sender.sendto(packet(1.0), ("127.0.0.1", receiver.port))
        assert receiver.newest(100.0).stale


def test_a_sender_that_begins_anew_is_followed(stream):
    receiver, send = stream
    send(packet(500.0))
    receiver.newest(0.05)
    send(packet(0.02))
    newest = receiver.newest(0.1)
    assert (time_of(newest), newest.stale) == (0.02, False)
    assert receiver.counts.late == 0


def test_a_packet_of_the_same_time_is_not_late(stream):
    """A sender whose clock stands still is a sender all the same."""
    receiver, send = stream
    for now in (0.05, 0.1, 0.15, 0.2):
        send(packet(0.0))
        assert not receiver.newest(now).stale
    assert receiver.counts.late == 0


def test_a_lost_hand_is_the_newest_record(stream):
    receiver, send = stream
    send(packet(6.9))
    send(LOST)
    newest = receiver.newest(0.05)
    assert newest.record.is_lost
    assert not newest.stale
    assert receiver.counts.lost == 1


def test_bad_packets_are_counted_by_reason_and_skipped(stream):
    receiver, send = stream
    send(packet(1.0))
    for data in (b"{", lz4.frame.compress(packet(2.0))[:-9], sent({"version": 2})):
        send(data)
    send(sent(rokoko_packet(in_world(HAND), "left")))
    assert time_of(receiver.newest(0.05)) == 1.0
    assert receiver.counts.received == 5
    assert receiver.counts.refused == {"malformed": 2, "version": 1, "hand": 1}
    assert "left glove only" in str(receiver.refusal)


def test_bad_packets_do_not_make_the_stream_look_alive(stream):
    receiver, send = stream
    send(packet(1.0))
    receiver.newest(0.05)
    for now in (0.1, 0.15, 0.2):
        send(b"{")
        newest = receiver.newest(now)
    assert newest.stale


@pytest.mark.parametrize("size", [9_000, 65_507])
def test_datagrams_of_any_size_arrive_whole(stream, size):
    receiver, send = stream
    send(packet(1.0).rjust(size))
    assert time_of(receiver.newest(0.05)) == 1.0


def test_a_flood_does_not_stop_the_tick(stream, monkeypatch):
    monkeypatch.setattr(receiver_module, "AT_ONCE", 3)
    receiver, send = stream
    for k in range(5):
        send(packet(1.0 + 0.01 * k))
    assert time_of(receiver.newest(0.05)) == 1.02
    assert time_of(receiver.newest(0.1)) == 1.04


def test_a_port_in_use_is_refused():
    with UdpReceiver(RokokoReader(), 0, "127.0.0.1") as receiver:
        with pytest.raises(DexFlexError, match=f"UDP port {receiver.port} of 127.0.0.1"):
            UdpReceiver(RokokoReader(), receiver.port, "127.0.0.1")
        port = receiver.port
    UdpReceiver(RokokoReader(), port, "127.0.0.1").close()


def test_what_is_no_port_is_refused():
    with pytest.raises(DexFlexError, match="UDP port 70000"):
        UdpReceiver(RokokoReader(), 70_000)
