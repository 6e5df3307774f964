"""What all readers share: packets as they come, the ways to refuse one, and numbers out of JSON."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol, get_args

import numpy as np

from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.streams.record import Array, Record, Side

Packet = bytes | Mapping[str, Any]
"""A datagram of JSON, in an LZ4 frame or not, or what a program in this process says in the same words."""
Reason = Literal["malformed", "version", "actor", "gloves", "hand", "joints"]
"""Why a packet yields no record: it is broken; it is of another version; it does not have the person, the
gloves, the hand or all joints that were asked for."""

LZ4_MAGIC = b"\x04\x22\x4d\x18"
"""First bytes of an LZ4 frame; JSON cannot begin so."""
LARGEST = 2**24
"""A datagram that unpacks to more bytes is no hand."""


class PacketError(DexFlexError):
    """A packet that yields no record: a receiver counts it by its reason and goes on."""

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(message)
        self.reason: Reason = reason


class Reader(Protocol):
    """Makes records of one format's packets. It remembers nothing, so that packets may be lost."""

    def read(self, data: Packet) -> Record:
        """Return what a packet says; a hand that its sender does not see is a record, too.

        Raises:
            PacketError: If the packet yields no record.
        """
        ...


def decoded(data: Packet) -> Mapping[str, Any]:
    """Return the JSON object of a packet.

    Raises:
        PacketError: If it is none.
        DexFlexError: If it is compressed and lz4 is not installed.
    """
    if isinstance(data, Mapping):
        return data
    text = _unpacked(data)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PacketError("malformed", f"A packet must be JSON, in an LZ4 frame or not. {error}.") from error
    return as_mapping(value, "the packet")


def _unpacked(data: bytes) -> bytes:
    if not data.startswith(LZ4_MAGIC):
        return data
    try:
        from lz4.frame import LZ4FrameDecompressor
    except ImportError as error:
        raise DexFlexError("The stream is compressed and lz4 is not installed: pip install lz4.") from error
    frame = LZ4FrameDecompressor()
    try:
        text = frame.decompress(data, max_length=LARGEST)
    except RuntimeError as error:
        raise PacketError("malformed", f"The packet is a damaged LZ4 frame. {error}.") from error
    if not frame.eof:
        raise PacketError("malformed", "The packet is an LZ4 frame that does not end, or ends after 16 MiB.")
    return text


def as_mapping(value: Any, name: str) -> Mapping[str, Any]:
    """Return a value that must be a JSON object."""
    if not isinstance(value, Mapping):
        raise PacketError("malformed", f"{name} must be a JSON object. Got {str(value)[:40]!r}.")
    return value


def as_sequence(value: Any, name: str, length: int | None = None) -> Sequence[Any]:
    """Return a value that must be a list or an array, of a length if one is given."""
    if not isinstance(value, list | tuple | np.ndarray) or length not in (None, len(value)):
        of = "" if length is None else f" of {length}"
        raise PacketError("malformed", f"{name} must be a list{of}. Got {str(value)[:40]!r}.")
    return list(value)


def as_time(value: Any, name: str, unit: float = 1.0) -> float:
    """Return a time [s] that was sent in `unit` [s]."""
    seconds = float(as_numbers([value], 1, name)[0]) * unit
    if not np.isfinite(seconds):
        raise PacketError("malformed", f"{name} must be a time. Got {str(value)[:40]!r}.")
    return seconds


def as_points(rows: Sequence[Any], name: str, width: int = 3) -> Array:
    """Return rows of numbers; a row that is None, or not finite, is lost and all NaN. Shape (rows, width)."""
    lost = np.full(width, np.nan)
    found = np.array([lost if row is None else as_numbers(row, width, name) for row in rows])
    return np.where(np.isfinite(found).all(1, keepdims=True), found, np.nan)


def as_numbers(values: Any, width: int, name: str) -> Array:
    """Return `width` numbers. Shape (width,)."""
    try:
        found = np.array(values, float)
    except (TypeError, ValueError, OverflowError) as error:
        raise PacketError("malformed", f"{name} must hold numbers. {str(error)[:80]}.") from error
    if found.shape != (width,):
        raise PacketError("malformed", f"{name} must hold {width} numbers. Got {str(values)[:40]!r}.")
    return found


def check_hand(hand: str) -> None:
    """Refuse the setting of a reader that names no hand."""
    if hand not in get_args(Side):
        raise DexFlexError(f"`hand` must be {' or '.join(get_args(Side))}. Got {hand!r}.")
