"""Receive a stream by UDP, without a thread: look once per tick, and take the newest."""

import socket
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Self

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.packets import PacketError, Reader
from lerobot_dexflex.streams.record import Record
from lerobot_dexflex.streams.source import STALE_AFTER, Newest

DATAGRAM = 2**16
"""No datagram of UDP is larger [bytes]; Rokoko's can have more than 8 kB."""
BUFFER = 2**20
"""What the system is asked to keep between two ticks [bytes]."""
AT_ONCE = 1000
"""Datagrams that one tick takes at most, whoever floods the port."""
NEW_CLOCK = 1.0
"""A time that lies further back [s] is no late packet: the sender began anew."""


@dataclass
class Counts:
    """What came so far."""

    received: int = 0
    """Datagrams."""
    late: int = 0
    """Records that were older, by their own time, than one that was there."""
    lost: int = 0
    """Records in which the hand was not seen; those that were late not counted."""
    refused: Counter[str] = field(default_factory=Counter)
    """Packets without a record, by the reason of their `PacketError`: `malformed`, `hand`, ..."""


class UdpReceiver:
    """Keeps the newest record that came to a port. Satisfies `Source`; close it, or use it in a `with`.

    Args:
        reader: Of the format that is sent.
        port: To listen at; 0 lets the system choose one.
        host: Address of this machine to listen at; all of them unless told.

    Raises:
        DexFlexError: If the port cannot be had.
    """

    def __init__(self, reader: Reader, port: int, host: str = "0.0.0.0") -> None:
        self._reader = reader
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            self._socket.setblocking(False)
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise DexFlexError(
                f"Cannot listen at UDP port {port} of {host} ({error}). Stop what uses it, or take another."
            ) from error
        self.port: int = self._socket.getsockname()[1]
        self.counts = Counts()
        self.refusal: PacketError | None = None
        """The last one, for who wonders why nothing comes."""
        self._record: Record | None = None
        self._came = self._looked = float("-inf")

    def newest(self, now: float) -> Newest:
        """Take what came and return the newest record.

        What waited at the first call, or through a pause of more than `STALE_AFTER`, is stale: nobody knows
        when it came.

        Args:
            now: The caller's clock [s].
        """
        came = now if now - self._looked <= STALE_AFTER else self._looked
        self._looked = now
        for data in self._waiting():
            self._take(data, came)
        return Newest(self._record, now - self._came > STALE_AFTER)

    def _waiting(self) -> Iterator[bytes]:
        for _ in range(AT_ONCE):
            try:
                yield self._socket.recv(DATAGRAM)
            except BlockingIOError:
                return
            except ConnectionError:  # Windows says so if an earlier answer was refused; there may be more.
                continue

    def _take(self, data: bytes, came: float) -> None:
        self.counts.received += 1
        try:
            record = self._reader.read(data)
        except PacketError as error:
            self.counts.refused[error.reason] += 1
            self.refusal = error
            return
        if self._record is not None and 0 < self._record.t - record.t <= NEW_CLOCK:
            self.counts.late += 1
            return
        self.counts.lost += record.is_lost
        self._record, self._came = record, came

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
