"""Make the source of a person's records."""

import contextlib
from collections.abc import Iterator
from typing import Any, cast

from lerobot_dexflex.streams.files import RecordWriter, ReplaySource, read_records
from lerobot_dexflex.streams.mediapipe import MediaPipeReader
from lerobot_dexflex.streams.openxr import OpenXRReader
from lerobot_dexflex.streams.packets import PacketError, Reader
from lerobot_dexflex.streams.receiver import UdpReceiver
from lerobot_dexflex.streams.record import Record
from lerobot_dexflex.streams.rokoko import RokokoReader
from lerobot_dexflex.streams.source import Newest, Source
from lerobot_dexflex.teleop.stream_config import StreamConfig


class StoredReceiver:
    """A receiver that stores every record that was the newest. Satisfies `Source`.

    Args:
        receiver: Where records come from.
        writer: Where they go.
    """

    def __init__(self, receiver: UdpReceiver, writer: RecordWriter) -> None:
        self._receiver, self._writer = receiver, writer
        self._stored: Record | None = None

    @property
    def refusal(self) -> PacketError | None:
        """Why the last refused packet was; see `UdpReceiver`."""
        return self._receiver.refusal

    def newest(self, now: float) -> Newest:
        """Return the newest record at `now` [s], and store it if it is new."""
        newest = self._receiver.newest(now)
        if newest.record is not None and newest.record is not self._stored:
            self._writer.append(newest.record)
            self._stored = newest.record
        return newest


def make_reader(source: str, config: StreamConfig) -> Reader:
    """Return the reader of a format.

    Raises:
        DexFlexError: If a setting is none of those that there are.
    """
    hand: Any = {"hand": config.hand, "mirror": config.hand == "left"}
    match source:
        case "rokoko":
            return RokokoReader(**hand, actor=config.actor, trust_wrist=config.trust_wrist)
        case "openxr":
            return OpenXRReader(**hand, quaternions=cast(Any, config.quaternions))
        case _:
            labels = cast(Any, config.labels)
            return MediaPipeReader(**hand, mirrored_image=config.mirrored_image, labels=labels)


@contextlib.contextmanager
def open_source(source: str, config: StreamConfig) -> Iterator[Source]:
    """Open a source for as long as it is needed.

    Args:
        source: One of `STREAMS`.
        config: How it is read; checked for this source.

    Raises:
        DexFlexError: If the port, or a file, cannot be had.
    """
    if config.file is not None:
        yield ReplaySource(read_records(config.file).records)
        return
    with contextlib.ExitStack() as stack:
        receiver = stack.enter_context(UdpReceiver(make_reader(source, config), config.port, config.host))
        if config.save is None:
            yield receiver
        else:
            yield StoredReceiver(receiver, stack.enter_context(RecordWriter(config.save)))
