"""Stored streams come back bit for bit, as far as they were written, and play by the clock they are given."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_hand import HAND, LEFTWARD, PLACE

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.files import RecordWriter, ReplaySource, read_records
from lerobot_dexflex.streams.record import Record


def made(t, rng=None):
    noise = rng.normal(0, 1e-3, (21, 3)) if rng else 0
    return Record(t, PLACE / 3, LEFTWARD, HAND + noise, np.ones(21, bool), True)


@pytest.fixture
def records():
    rng = np.random.default_rng(0)
    whole = [made(0.1 + 0.05 * k, rng) for k in range(3)]
    part = replace(whole[0], t=0.3, tracked=np.arange(21) % 3 > 0)
    return [*whole, part, replace(whole[1], t=0.35, wrist_tracked=False), Record.lost(0.4)]


@pytest.fixture
def path(tmp_path, records):
    path = tmp_path / "new" / "stream.jsonl"
    with RecordWriter(path) as writer:
        for record in records:
            writer.append(record)
    return path


def time_of(source, now):
    record = source.newest(now).record
    assert record is not None
    return record.t


def same(one, other):
    assert (one.t, one.wrist_tracked) == (other.t, other.wrist_tracked)
    for name in ("wrist_position", "wrist_rotation", "keypoints", "tracked"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_records_come_back_bit_for_bit(path, records):
    stored = read_records(path)
    assert not stored.torn
    for found, written in zip(stored.records, records, strict=True):
        same(found, written)


def test_a_record_is_there_as_soon_as_it_is_written(tmp_path, records):
    writer = RecordWriter(tmp_path / "stream.jsonl")
    writer.append(records[0])
    stored = read_records(tmp_path / "stream.jsonl")
    assert (len(stored.records), stored.torn) == (1, False)
    writer.close()


def test_wherever_the_last_line_is_torn_the_others_come_back(path, records):
    content = path.read_bytes()
    last = content.rstrip(b"\n").rfind(b"\n") + 1
    for end in (*range(last + 1, len(content) - 1, 20), len(content) - 1):
        path.write_bytes(content[:end])
        stored = read_records(path)
        assert stored.torn
        assert len(stored.records) == len(records) - 1
    path.write_bytes(content[:last])
    assert not read_records(path).torn


def test_a_damaged_line_in_between_is_named(path):
    lines = path.read_text().splitlines(keepends=True)
    for damaged in (
        "{\n",
        '{"t":1}\n',
        "[]\n",
        lines[3].replace("0.", "9.", 8),
        lines[3].replace("[[", "[", 1),
    ):
        path.write_text("".join([*lines[:3], damaged, *lines[4:]]))
        with pytest.raises(DexFlexError, match="line 4 is damaged"):
            read_records(path)


@pytest.mark.parametrize(
    "text", ["", "{}", '{"format":"lerobot_dexflex.streams","version":2}\n', "t,x\n1,2\n"]
)
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "stream.jsonl"
    path.write_text(text)
    with pytest.raises(DexFlexError, match="is no stream of this version"):
        read_records(path)


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(DexFlexError, match="cannot be read"):
        read_records(tmp_path / "stream.jsonl")


def test_an_older_stream_is_never_overwritten(path):
    before = path.read_bytes()
    with pytest.raises(DexFlexError, match="nothing was changed"):
        RecordWriter(path)
    assert path.read_bytes() == before


def test_a_stream_is_played_at_its_own_pace():
    records = [made(t) for t in (10.0, 10.05, 10.1, 10.3)]
    source = ReplaySource(records)
    assert source.duration == pytest.approx(0.3)
    expected = {5.0: 10.0, 5.049: 10.0, 5.051: 10.05, 5.11: 10.1, 5.19: 10.1, 5.29: 10.1, 5.31: 10.3}
    assert [time_of(source, now) for now in expected] == list(expected.values())


def test_a_clock_that_adds_up_ticks_plays_one_record_per_tick():
    records = [made(10 + 0.05 * k) for k in range(100)]
    source, now = ReplaySource(records), 0.0
    for record in records:
        assert source.newest(now).record is record
        now += 0.05


def test_a_gap_and_the_end_of_a_stream_are_stale():
    source = ReplaySource([made(t) for t in (10.0, 10.05, 10.3)])
    stale = {5.0: False, 5.05: False, 5.14: False, 5.16: True, 5.31: False, 5.39: False, 5.41: True}
    assert [source.newest(now).stale for now in stale] == list(stale.values())


def test_a_stream_is_played_as_fast_as_asked():
    records = [made(10 + 0.05 * k) for k in range(10)]
    source = ReplaySource(records, speed=4)
    assert source.duration == pytest.approx(0.45 / 4)
    # After 50 ms, four records have passed.
    assert [time_of(source, now) for now in (5.0, 5.05, 5.1)] == pytest.approx([10.0, 10.2, 10.4])


@pytest.mark.parametrize(
    ("times", "speed", "message"),
    [
        ((), 1, "needs records"),
        ((2.0, 1.0), 1, "never goes back"),
        ((1.0,), 0, "`speed`"),
        ((1.0,), -1, "`speed`"),
    ],
)
def test_what_cannot_be_played_is_refused(times, speed, message):
    with pytest.raises(DexFlexError, match=message):
        ReplaySource([made(t) for t in times], speed)
