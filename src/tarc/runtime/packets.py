"""Packets between loop and robot: one datagram each, with a checksum."""

import struct
import zlib
from collections.abc import Sequence
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np

from tarc.core.types import Array

MAGIC = b"TARC"
VERSION = 1
HEADER = struct.Struct("<4sBBBBId")
"""Magic, version, kind, number of joints, flags, sequence number, time stamp [s]; 20 bytes, little-endian."""
CHECKSUM = struct.Struct("<I")
"""CRC-32 of all bytes before it."""
MAX_JOINTS = 64
MAX_SIZE = 2048
"""Largest packet [bytes]."""


class Kind(IntEnum):
    """What a packet carries."""

    STATE = 1
    """From the robot: n positions [rad or m], then n torques [N m or N], NaN for none."""
    COMMAND = 2
    """To the robot: n torques [N m or N]."""
    NAMES = 3
    """From the robot: the names of its joints in order, UTF-8, a line feed between two."""


class Flag(IntFlag):
    """What a command says beside the torque."""

    RELEASE = 1
    """The brakes are to be released."""
    STOP = 2
    """Safe stop: the brakes are to be engaged, and stay so."""
    HELLO = 4
    """The names of the joints are to be sent; the command has no torque."""


class Packet(NamedTuple):
    """A decoded packet; a state has values of shape (2, n), a command (1, n)."""

    kind: Kind
    flags: Flag
    sequence: int
    time: float
    values: Array
    names: tuple[str, ...]


NO_VALUES = np.zeros((0, 0))


def encode(
    kind: Kind,
    sequence: int,
    time: float,
    values: Sequence[Array] = (),
    *,
    names: Sequence[str] = (),
    flags: int = 0,
) -> bytes:
    """Return the bytes of a packet: header, doubles or names, checksum."""
    if kind == Kind.NAMES:
        n, body = len(names), "\n".join(names).encode()
    else:
        n = len(values[0]) if len(values) else 0
        body = np.concatenate(values).astype("<f8").tobytes() if n else b""
    content = HEADER.pack(MAGIC, VERSION, kind, n, flags, sequence & 0xFFFFFFFF, time) + body
    return content + CHECKSUM.pack(zlib.crc32(content))


def decode(data: bytes) -> Packet | None:
    """Return the packet that some bytes are; None for bytes that are none."""
    size = len(data) - HEADER.size - CHECKSUM.size
    if size < 0 or len(data) > MAX_SIZE:
        return None
    magic, version, kind, n, flags, sequence, time = HEADER.unpack_from(data)
    if magic != MAGIC or version != VERSION or n > MAX_JOINTS:
        return None
    if CHECKSUM.unpack_from(data, len(data) - CHECKSUM.size)[0] != zlib.crc32(data[: -CHECKSUM.size]):
        return None
    body = data[HEADER.size : -CHECKSUM.size]
    if kind == Kind.NAMES:
        names = _names(body)
        return Packet(Kind.NAMES, Flag(0), sequence, time, NO_VALUES, names) if len(names) == n > 0 else None
    if kind == Kind.COMMAND and flags & Flag.HELLO and not size:
        return Packet(Kind.COMMAND, Flag(flags & 7), sequence, time, NO_VALUES, ())
    rows = {Kind.STATE: 2, Kind.COMMAND: 1}.get(kind, 0)
    if not rows or not n or size != 8 * rows * n:
        return None
    values = np.frombuffer(body, "<f8").reshape(rows, n)
    if kind == Kind.COMMAND and not np.all(np.isfinite(values)):
        return None
    return Packet(Kind(kind), Flag(flags & 7), sequence, time, values, ())


def is_newer(sequence: int, last: int) -> bool:
    """Return whether a sequence number comes after another, modulo 2³²."""
    return 0 < (sequence - last) & 0xFFFFFFFF < 0x80000000


def _names(body: bytes) -> tuple[str, ...]:
    try:
        return tuple(body.decode().split("\n"))
    except UnicodeDecodeError:
        return ()
