# SPDX-License-Identifier: GPL-3.0-or-later
"""The datagram that senders send: one hand at one time, 864 bytes.

Little-endian, without padding:

| bytes | field | type |
|---|---|---|
| 0 | magic, ``TCHF`` | 4 bytes |
| 4 | version, 1 | uint8 |
| 5 | kind of tracker, an index into `SOURCES` | uint8 |
| 6 | side: 0 left, 1 right | uint8 |
| 7 | active: 1 if a hand is in view, otherwise 0 | uint8 |
| 8 | sequence: number of the sender's frame, wraps around | uint32 |
| 12 | source time: when the hand was seen [ns], the sender's ``time.perf_counter_ns`` | int64 |
| 20 | confidence, 0 to 1 | float32 |
| 24 | valid: a bit for each joint whose pose may be used | uint32 |
| 28 | tracked: a bit for each joint that was observed rather than inferred | uint32 |
| 32 | 26 joints: position [m], quaternion x y z w, radius [m] | 26 × 8 float32 |

Joints are those of OpenXR's XR_EXT_hand_tracking, in its order and with its axes. Tracking space is
right-handed with Y up and the tracker at the origin.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .....solver.core.errors import TactileClayError
from .joints import ALL_JOINTS, JOINT_COUNT, SIDES, WRIST

MAGIC = b"TCHF"
VERSION = 1
PORT = 47121
"""Default port on loopback."""
SOURCES = ("unknown", "leap", "mediapipe", "hts", "openxr")
"""Kinds of tracker; the index of each is its code in a datagram. Other codes mean unknown."""

_HEADER = struct.Struct("<4sBBBBIqfII")
PACKET_SIZE = _HEADER.size + JOINT_COUNT * 8 * 4
_MAX_COORDINATE = 100.0
_MAX_RADIUS = 0.2
_MAX_TIME = 1 << 62


class PacketError(TactileClayError, ValueError):
    """A datagram is not a valid hand; the message says why."""


def _no_joints() -> NDArray[np.float32]:
    joints = np.zeros((JOINT_COUNT, 8), np.float32)
    joints[:, 6] = 1.0
    return joints


@dataclass(frozen=True, kw_only=True, eq=False)
class HandFrame:
    """One hand at one time."""

    side: str
    """Left or right."""
    source_time: int
    """When the hand was seen [ns], on the sender's clock."""
    sequence: int = 0
    """Number of the sender's frame; wraps around at 2^32."""
    source: str = "unknown"
    """A name in `SOURCES`."""
    active: bool = True
    """Whether a hand is in view; if not, the joints are meaningless."""
    confidence: float = 1.0
    """The tracker's confidence, 0 to 1."""
    valid: int = ALL_JOINTS
    """A bit for each joint whose pose may be used."""
    tracked: int = ALL_JOINTS
    """A bit for each joint that was observed rather than inferred."""
    joints: NDArray[np.float32] = field(default_factory=_no_joints)
    """Position [m], quaternion (x, y, z, w) and radius [m] of each joint, shape [26, 8]."""

    @property
    def positions(self) -> NDArray[np.float32]:
        """Position of each joint [m], shape [26, 3]."""
        return self.joints[:, :3]

    @property
    def quaternions(self) -> NDArray[np.float32]:
        """Orientation of each joint (x, y, z, w), shape [26, 4]."""
        return self.joints[:, 3:7]

    @property
    def radii(self) -> NDArray[np.float32]:
        """Distance from each joint to the skin [m], shape [26]."""
        return self.joints[:, 7]

    @property
    def usable(self) -> bool:
        """Whether there is a hand with a valid wrist."""
        return self.active and bool(self.valid >> WRIST & 1)


def joint_array(
    positions: ArrayLike, quaternions: ArrayLike, radii: ArrayLike
) -> NDArray[np.float32]:
    """Stack positions [m], [26, 3], quaternions, [26, 4], and radii [m], [26], to shape [26, 8]."""
    return np.column_stack([positions, quaternions, radii]).astype(np.float32)


def encode(frame: HandFrame) -> bytes:
    """Encode a frame as a datagram.

    Raises:
        PacketError: A receiver would reject the frame; the message says why.
    """
    if frame.side not in SIDES:
        raise PacketError(f"The side must be left or right, not {frame.side!r}.")
    try:
        header = _HEADER.pack(
            MAGIC,
            VERSION,
            SOURCES.index(frame.source) if frame.source in SOURCES else 0,
            SIDES.index(frame.side),
            frame.active,
            frame.sequence & 0xFFFFFFFF,
            frame.source_time,
            frame.confidence,
            frame.valid,
            frame.tracked,
        )
    except (struct.error, OverflowError) as error:
        raise PacketError(f"A number of the frame does not fit its field ({error}).") from error
    data = header + np.ascontiguousarray(frame.joints, "<f4").tobytes()
    decode(data)
    return data


def decode(data: bytes | bytearray | memoryview) -> HandFrame:
    """Decode a datagram and normalize its quaternions.

    Raises:
        PacketError: It does not have this format, or its values are implausible.
    """
    if len(data) != PACKET_SIZE:
        raise PacketError("wrong length")
    magic, version, source, side, active, sequence, time, confidence, valid, tracked = (
        _HEADER.unpack_from(data)
    )
    if magic != MAGIC:
        raise PacketError("wrong magic")
    if version != VERSION:
        raise PacketError("unknown version")
    if side >= len(SIDES):
        raise PacketError("bad side")
    if active > 1:
        raise PacketError("bad active flag")
    if not 0 <= time < _MAX_TIME:
        raise PacketError("bad source time")
    if not 0.0 <= confidence <= 1.0:
        raise PacketError("bad confidence")
    if (valid | tracked) & ~ALL_JOINTS:
        raise PacketError("bits of joints that do not exist")
    joints = np.frombuffer(data, "<f4", offset=_HEADER.size).reshape(JOINT_COUNT, 8)
    return HandFrame(
        side=SIDES[side],
        source_time=time,
        sequence=sequence,
        source=SOURCES[source] if source < len(SOURCES) else "unknown",
        active=bool(active),
        confidence=confidence,
        valid=valid,
        tracked=tracked,
        joints=_checked(joints, valid) if active else _no_joints(),
    )


def _checked(joints: NDArray[np.float32], valid: int) -> NDArray[np.float32]:
    """Check joints, normalize their quaternions and reset those that are not valid."""
    if not np.isfinite(joints).all():
        raise PacketError("values that are not finite")
    usable = (valid >> np.arange(JOINT_COUNT) & 1).astype(bool)
    result = joints.astype(np.float32)
    result[~usable] = _no_joints()[~usable]
    if np.abs(result[:, :3]).max() > _MAX_COORDINATE:
        raise PacketError("a position too far away")
    if not (result[:, 7].min() >= 0.0 and result[:, 7].max() <= _MAX_RADIUS):
        raise PacketError("an implausible radius")
    # In float64, because the squares of huge components would overflow in float32.
    quaternions = result[:, 3:7].astype(np.float64)
    norms = np.linalg.norm(quaternions, axis=1)
    if np.abs(norms - 1.0).max() > 0.01:
        raise PacketError("a quaternion that is not normalized")
    result[:, 3:7] = quaternions / norms[:, None]
    return result
