# SPDX-License-Identifier: GPL-3.0-or-later
"""The datagram: encoding, decoding and validation."""

import struct
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking.protocol.joints import ALL_JOINTS, JOINT_COUNT, WRIST
from tactile_clay.clay_addon.core.tracking.protocol.packet import (
    MAGIC,
    PACKET_SIZE,
    SOURCES,
    PacketError,
    decode,
    encode,
)
from tactile_clay.tests.clay_addon.core.tracking.hands import flat_hand, frame_at

GOOD = encode(frame_at(123_456_789, 77, "left", confidence=0.75, tracked=0b101))


def test_layout_is_as_documented() -> None:
    """Place the fields at the documented offsets."""
    assert PACKET_SIZE == len(GOOD) == 864
    assert GOOD[:8] == MAGIC + bytes([1, SOURCES.index("leap"), 0, 1])
    assert struct.unpack_from("<IqfII", GOOD, 8) == (77, 123_456_789, 0.75, ALL_JOINTS, 0b101)
    wrist = struct.unpack_from("<8f", GOOD, 32 + 32 * WRIST)
    assert wrist == pytest.approx((0.0, 0.2, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0185))


@given(
    side=st.sampled_from(["left", "right"]),
    sequence=st.integers(0, 2**32 - 1),
    time=st.integers(0, 2**62 - 1),
    confidence=st.floats(0.0, 1.0, width=32),
    valid=st.integers(0, ALL_JOINTS),
    place=st.tuples(*[st.floats(-50.0, 50.0)] * 3),
)
def test_frames_survive_encoding(side, sequence, time, confidence, valid, place) -> None:
    """Decode what was encoded, bit by bit except for the normalization of quaternions."""
    frame = frame_at(time, sequence, side, place, confidence=confidence, valid=valid)
    read = decode(encode(frame))
    assert (read.side, read.sequence, read.source_time) == (side, sequence, time)
    assert (read.confidence, read.valid, read.source) == (confidence, valid, "leap")
    usable = [joint for joint in range(JOINT_COUNT) if valid >> joint & 1]
    assert np.array_equal(read.positions[usable], frame.positions[usable])
    assert np.allclose(read.quaternions[usable], frame.quaternions[usable], atol=1e-6)
    assert np.allclose(np.linalg.norm(read.quaternions, axis=1), 1.0, atol=1e-6)
    assert read.usable == bool(valid >> WRIST & 1)


@given(st.binary(max_size=2000) | st.binary(min_size=PACKET_SIZE, max_size=PACKET_SIZE))
def test_noise_is_refused(data: bytes) -> None:
    """Refuse random bytes with a PacketError."""
    with pytest.raises(PacketError):
        decode(data)


@given(st.integers(0, PACKET_SIZE - 1), st.integers(0, 255))
def test_changed_byte_is_refused_or_gives_a_valid_hand(offset: int, value: int) -> None:
    """Return a finite hand or refuse the datagram, whatever the value of a byte."""
    data = bytearray(GOOD)
    data[offset] = value
    try:
        frame = decode(bytes(data))
    except PacketError:
        return
    assert np.isfinite(frame.joints).all()
    assert np.allclose(np.linalg.norm(frame.quaternions, axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize(
    ("joint", "column", "value", "reason"),
    [
        (3, 0, np.nan, "not finite"),
        (3, 7, np.inf, "not finite"),
        (9, 2, 1e30, "too far"),
        (9, 2, -101.0, "too far"),
        (9, 7, 0.3, "radius"),
        (9, 7, -0.001, "radius"),
        (25, 6, 1.5, "not normalized"),
        (25, 6, 3e38, "not normalized"),
    ],
)
def test_implausible_joints_are_refused(joint, column, value, reason) -> None:
    """Refuse values that are not finite, huge, or not a rotation, and say why."""
    joints = flat_hand()
    joints[joint, column] = value
    with pytest.raises(PacketError, match=reason):
        encode(frame_at(1, joints=joints))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"side": "middle"}, "left or right"),
        ({"confidence": 1.01}, "confidence"),
        ({"confidence": float("nan")}, "confidence"),
        ({"source_time": -1}, "source time"),
        ({"source_time": 1 << 70}, "does not fit"),
        ({"valid": 1 << 26}, "do not exist"),
        ({"tracked": -1}, "does not fit"),
    ],
)
def test_invalid_headers_are_refused(changes, reason) -> None:
    """Refuse header fields out of range."""
    with pytest.raises(PacketError, match=reason):
        encode(replace(frame_at(1), **changes))


@pytest.mark.parametrize(
    ("offset", "value", "reason"),
    [(0, 0, "magic"), (4, 2, "version"), (6, 2, "side"), (7, 2, "active")],
)
def test_foreign_headers_are_refused(offset, value, reason) -> None:
    """Refuse another format, another version, and a third side."""
    data = bytearray(GOOD)
    data[offset] = value
    with pytest.raises(PacketError, match=reason):
        decode(data)


def test_invalid_joints_are_reset() -> None:
    """Reset joints whose valid bit is not set, whatever their values."""
    joints = flat_hand()
    joints[5] = [1e9, 0, 0, 0, 0, 0, 0, 5.0]
    frame = decode(encode(frame_at(1, joints=joints, valid=ALL_JOINTS & ~(1 << 5))))
    assert frame.joints[5].tolist() == [0, 0, 0, 0, 0, 0, 1, 0]
    absent = decode(encode(frame_at(1, joints=np.zeros((26, 8), np.float32), active=False)))
    assert not absent.usable
