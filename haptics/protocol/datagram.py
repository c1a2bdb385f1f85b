# SPDX-License-Identifier: GPL-3.0-or-later
"""The datagrams between an `ArrayClient` and an array server.

Little-endian, one message per datagram::

    offset  size  content
         0     4  magic "TCFP"
         4     1  version, 1
         5     1  kind, see `Kind`
         6     1  modulation, see `Modulation` (focal points only, else 0)
         7     1  reserved, 0
         8     4  session: the number that the server gave to the client that started it
        12     4  number of focal points, or of bytes of JSON
        16     8  sequence number, which increases with every datagram of a session
        24     8  time: the monotonic clock [ns], shared by all processes of a machine
        32        body: count × (x, y, z [m], pressure [Pa]) float32 in the array's frame, or JSON
       end     4  CRC-32 of everything before it

A datagram that deviates from this in any way is rejected as a whole.
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
"""Maximum number of focal points in a datagram."""
MAX_SIZE = 60_000
"""Maximum size of a datagram [bytes]; the loopback device takes 65,507."""

_HEAD = struct.Struct("<4sBBBBIIQQ")
_CHECK = struct.Struct("<I")
_POINT_SIZE = 16
HEAD_SIZE = _HEAD.size


class Kind(enum.IntEnum):
    """Type of a datagram."""

    FOCI = 1
    """Client to server: emit these focal points; an empty list means silence."""
    HELLO = 2
    """Client to server: send your status to this address."""
    STOP = 3
    """Client to server: silence the array and exit."""
    STATUS = 4
    """Server to client: the server's status, as JSON."""
    ASK_DRIVE = 5
    """Client to server: send the device's current drive."""
    DRIVE = 6
    """Server to client: the device's current drive, as JSON with real and imaginary parts."""


class Modulation(enum.IntEnum):
    """How the sound is modulated so that focal points can be felt."""

    AMPLITUDE = 0
    """On and off at 200 Hz, where the skin's Pacinian receptors are most sensitive."""
    NONE = 1
    """Constant pressure, for measurements; barely perceptible."""


class DatagramError(TactileClayError, ValueError):
    """The bytes are not a valid datagram; the message says why."""


@dataclass(frozen=True)
class Datagram:
    """A complete, well-formed datagram.

    `Gate` checks whether it is recent and permitted: session and time are whatever the sender
    claims.
    """

    kind: Kind
    """Type of the datagram."""
    session: int
    """Number of the sender's session."""
    sequence: int
    """Sequence number within the session."""
    time: float
    """When it was sent, by the sender's monotonic clock [s]."""
    modulation: Modulation = Modulation.AMPLITUDE
    """How to modulate the sound."""
    positions: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    """Focal points in the array's frame [m], shape [K, 3]."""
    pressures: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    """Sound pressure amplitude at each [Pa], shape [K]."""
    table: dict[str, Any] | None = None
    """Content of the JSON body."""


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
    """Encode a datagram.

    Args:
        kind: Type of the datagram.
        session: Number of the session, below 2³².
        sequence: Sequence number, below 2⁶⁴.
        time: The monotonic clock [s].
        modulation: How to modulate the sound.
        positions: Focal points in the array's frame [m], shape [K, 3].
        pressures: Pressure amplitudes [Pa], shape [K].
        table: Content of the JSON body.

    Raises:
        ValueError: Shapes do not agree, or the datagram is too long.
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
            raise ValueError(f"{len(points)} focal points exceed the maximum of {MAX_FOCI}")
        rows = np.empty((len(points), 4), "<f4")
        rows[:, :3] = points
        rows[:, 3] = values
        body, count = rows.tobytes(), len(points)
    head = _HEAD.pack(
        MAGIC, VERSION, kind, modulation, 0, session, count, sequence, round(time * 1e9)
    )
    if len(head) + len(body) + _CHECK.size > MAX_SIZE:
        raise ValueError(f"a datagram body of {len(body)} bytes is too long")
    return head + body + _CHECK.pack(zlib.crc32(head + body))


def decode(data: bytes) -> Datagram:
    """Decode a datagram.

    Raises:
        DatagramError: The bytes are not exactly what `encode` writes.
    """
    if len(data) < HEAD_SIZE + _CHECK.size:
        raise DatagramError("too short")
    if len(data) > MAX_SIZE:
        raise DatagramError("too long")
    magic, version, kind, modulation, reserved, session, count, sequence, nanoseconds = (
        _HEAD.unpack_from(data)
    )
    if magic != MAGIC:
        raise DatagramError("wrong magic number")
    if version != VERSION:
        raise DatagramError(f"not version {VERSION}")
    if _CHECK.unpack_from(data, len(data) - _CHECK.size)[0] != zlib.crc32(data[: -_CHECK.size]):
        raise DatagramError("wrong checksum")
    if kind not in Kind.__members__.values():
        raise DatagramError("unknown kind")
    if reserved or modulation not in Modulation.__members__.values():
        raise DatagramError("unknown modulation")
    body = data[HEAD_SIZE : -_CHECK.size]
    head = Datagram(Kind(kind), session, sequence, nanoseconds * 1e-9, Modulation(modulation))
    if head.kind in (Kind.STATUS, Kind.DRIVE):
        return _with_table(head, body, count)
    if head.kind is not Kind.FOCI:
        if count or body:
            raise DatagramError("unexpected body")
        return head
    if count > MAX_FOCI or len(body) != count * _POINT_SIZE:
        raise DatagramError("count and length do not match")
    rows = np.frombuffer(body, "<f4").reshape(count, 4).astype(np.float32)
    return replace(
        head,
        positions=np.ascontiguousarray(rows[:, :3]),
        pressures=np.ascontiguousarray(rows[:, 3]),
    )


def _with_table(head: Datagram, body: bytes, count: int) -> Datagram:
    if len(body) != count:
        raise DatagramError("count and length do not match")
    try:
        table = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise DatagramError("not JSON") from error
    if not isinstance(table, dict):
        raise DatagramError("not a JSON object")
    return replace(head, table=table)
