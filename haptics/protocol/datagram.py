# SPDX-License-Identifier: GPL-3.0-or-later
"""The datagrams between an `ArrayClient` and an array server.

Little-endian, one message a datagram::

    offset  size  what
         0     4  magic "TCFP"
         4     1  version, 1
         5     1  kind, see `Kind`
         6     1  modulation, see `Modulation` (focal points only, else 0)
         7     1  reserved, 0
         8     4  session: the number that the server gave to the client that started it
        12     4  count: of focal points, or of bytes of JSON
        16     8  sequence, rising with every datagram of a session
        24     8  time: the sender's monotonic clock [ns], which one machine's processes share
        32        body: count × (x, y, z [m], pressure [Pa]) float32 in the array's frame, or JSON
       end     4  CRC-32 of all before it

A datagram that is not exactly so is refused whole.
"""

from __future__ import annotations

import enum
import json
import struct
import zlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError

MAGIC = b"TCFP"
VERSION = 1
MAX_FOCI = 64
"""Most focal points in a datagram."""
MAX_SIZE = 60_000
"""Longest datagram [bytes]; the loopback device takes 65,507."""

_HEAD = struct.Struct("<4sBBBBIIQQ")
_CHECK = struct.Struct("<I")
_POINT_SIZE = 16
HEAD_SIZE = _HEAD.size


class Kind(enum.IntEnum):
    """What a datagram says."""

    FOCI = 1
    """Client to server: emit these focal points; none of them means silence."""
    HELLO = 2
    """Client to server: send your status here."""
    STOP = 3
    """Client to server: silence, and end."""
    STATUS = 4
    """Server to client: how it goes, as JSON."""
    ASK_DRIVE = 5
    """Client to server: send what the device holds."""
    DRIVE = 6
    """Server to client: what the device holds, as JSON with real and imaginary parts."""


class Modulation(enum.IntEnum):
    """How focal points are made to be felt."""

    AMPLITUDE = 0
    """On and off at 200 Hz, which the skin's Pacinian receptors feel best."""
    NONE = 1
    """A steady pressure, for measuring; hardly felt."""


class DatagramError(TactileClayError, ValueError):
    """A datagram is not one of ours; the message says what is wrong with it."""


@dataclass(frozen=True)
class Datagram:
    """A datagram that is whole and well formed; whether it is fresh and allowed is not its
    business.

    The time and the session are the sender's word.
    """

    kind: Kind
    """What it says."""
    session: int
    """Whom it is from."""
    sequence: int
    """Which one it is."""
    time: float
    """When it was sent, by the sender's monotonic clock [s]."""
    modulation: Modulation = Modulation.AMPLITUDE
    """How to modulate."""
    positions: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    """Focal points in the array's frame [m], shape [K, 3]."""
    pressures: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    """Sound pressure amplitude at each [Pa], shape [K]."""
    table: dict[str, Any] | None = None
    """What the JSON said."""


def encode(
    kind: Kind,
    *,
    session: int,
    sequence: int,
    time: float,
    modulation: Modulation = Modulation.AMPLITUDE,
    positions: NDArray[np.floating] | None = None,
    pressures: NDArray[np.floating] | None = None,
    table: dict[str, Any] | None = None,
) -> bytes:
    """Write a datagram.

    Args:
        kind: What it says.
        session: Number of the session, below 2³².
        sequence: Number of the datagram, below 2⁶⁴.
        time: The monotonic clock [s].
        modulation: How to modulate.
        positions: Focal points in the array's frame [m], shape [K, 3].
        pressures: Pressure amplitudes [Pa], shape [K].
        table: What to say as JSON.

    Raises:
        ValueError: Shapes do not agree, or it is too long.
    """
    if table is not None:
        body = json.dumps(table, allow_nan=False).encode()
        count = len(body)
    else:
        points = np.zeros((0, 3)) if positions is None else np.asarray(positions)
        values = np.zeros(0) if pressures is None else np.asarray(pressures)
        if points.ndim != 2 or points.shape[1] != 3 or values.shape != (len(points),):
            raise ValueError(
                f"focal points need positions of shape [K, 3] and pressures of shape [K], "
                f"not {points.shape} and {values.shape}"
            )
        if len(points) > MAX_FOCI:
            raise ValueError(f"{len(points)} focal points are more than {MAX_FOCI}")
        rows = np.empty((len(points), 4), "<f4")
        rows[:, :3] = points
        rows[:, 3] = values
        body, count = rows.tobytes(), len(points)
    head = _HEAD.pack(
        MAGIC, VERSION, kind, modulation, 0, session, count, sequence, round(time * 1e9)
    )
    if len(head) + len(body) + _CHECK.size > MAX_SIZE:
        raise ValueError(f"a datagram of {len(body)} bytes is too long")
    return head + body + _CHECK.pack(zlib.crc32(head + body))


def decode(data: bytes) -> Datagram:
    """Read a datagram.

    Raises:
        DatagramError: It is not exactly what `encode` writes.
    """
    if len(data) < HEAD_SIZE + _CHECK.size:
        raise DatagramError("too short")
    if len(data) > MAX_SIZE:
        raise DatagramError("too long")
    magic, version, number, way, reserved, session, count, sequence, nanoseconds = (
        _HEAD.unpack_from(data)
    )
    if magic != MAGIC:
        raise DatagramError("another magic number")
    if version != VERSION:
        raise DatagramError(f"not of version {VERSION}")
    if _CHECK.unpack_from(data, len(data) - _CHECK.size)[0] != zlib.crc32(data[: -_CHECK.size]):
        raise DatagramError("the checksum does not fit")
    if number not in Kind.__members__.values():
        raise DatagramError("an unknown kind")
    if reserved or way not in Modulation.__members__.values():
        raise DatagramError("an unknown modulation")
    kind = Kind(number)
    body = data[HEAD_SIZE : -_CHECK.size]
    head = Datagram(kind, session, sequence, nanoseconds * 1e-9, Modulation(way))
    if kind in (Kind.STATUS, Kind.DRIVE):
        return _with_table(head, body, count)
    if kind is not Kind.FOCI:
        if count or body:
            raise DatagramError("a body where there should be none")
        return head
    if count > MAX_FOCI or len(body) != count * _POINT_SIZE:
        raise DatagramError("the count does not fit the length")
    rows = np.frombuffer(body, "<f4").reshape(count, 4).astype(np.float32)
    return replace(
        head,
        positions=np.ascontiguousarray(rows[:, :3]),
        pressures=np.ascontiguousarray(rows[:, 3]),
    )


def _with_table(head: Datagram, body: bytes, count: int) -> Datagram:
    if len(body) != count:
        raise DatagramError("the count does not fit the length")
    try:
        table = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise DatagramError("not JSON") from error
    if not isinstance(table, dict):
        raise DatagramError("not a JSON table")
    return replace(head, table=table)
