# SPDX-License-Identifier: GPL-3.0-or-later
"""Datagrams: decoding returns what was encoded, and rejects everything else."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tactile_clay.haptics.protocol.datagram import (
    HEAD_SIZE,
    MAX_FOCI,
    DatagramError,
    Kind,
    Modulation,
    decode,
    encode,
)

rows = hnp.arrays(
    np.float32,
    st.tuples(st.integers(0, MAX_FOCI), st.just(4)),
    elements=st.floats(width=32, allow_nan=True, allow_infinity=True),
)


@given(
    rows,
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
    st.floats(0.0, 1e9),
    st.sampled_from(Modulation),
)
def test_focal_points_round_trip(
    table: np.ndarray, session: int, sequence: int, time: float, modulation: Modulation
) -> None:
    """Decode exactly what was encoded, for any numbers."""
    data = encode(
        Kind.FOCI,
        session=session,
        sequence=sequence,
        time=time,
        modulation=modulation,
        positions=table[:, :3],
        pressures=table[:, 3],
    )
    read = decode(data)
    assert (read.kind, read.session, read.sequence) == (Kind.FOCI, session, sequence)
    assert read.modulation is modulation
    assert read.time == pytest.approx(time, abs=1e-6)
    assert np.array_equal(read.positions, table[:, :3], equal_nan=True)
    assert np.array_equal(read.pressures, table[:, 3], equal_nan=True)


@given(st.dictionaries(st.text(), st.one_of(st.none(), st.booleans(), st.integers(), st.text())))
def test_tables_round_trip(table: dict) -> None:
    """Decode the JSON body of a status."""
    assert decode(encode(Kind.STATUS, session=1, sequence=2, time=3.0, table=table)).table == table


@given(st.binary(max_size=300))
def test_noise_is_refused(data: bytes) -> None:
    """Refuse arbitrary bytes with a DatagramError and no other error."""
    with pytest.raises(DatagramError):
        decode(data)


@given(st.data())
def test_any_change_is_refused(data: st.DataObject) -> None:
    """Refuse a datagram with a flipped bit, or one that was truncated or extended."""
    whole = encode(
        Kind.FOCI,
        session=7,
        sequence=9,
        time=1.0,
        positions=np.full((2, 3), 0.1),
        pressures=np.array((900.0, 500.0)),
    )
    changed = bytearray(whole)
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    changed[bit // 8] ^= 1 << (bit % 8)
    for bad in (
        bytes(changed),
        whole[: data.draw(st.integers(0, len(whole) - 1))],
        whole + data.draw(st.binary(min_size=1, max_size=40)),
    ):
        with pytest.raises(DatagramError):
            decode(bad)


def forged(head: tuple[int, ...], body: bytes) -> bytes:
    """A datagram with a correct checksum and an arbitrary header."""
    data = struct.pack("<4sBBBBIIQQ", b"TCFP", *head) + body
    return data + struct.pack("<I", zlib.crc32(data))


@given(
    st.tuples(
        st.just(1),
        st.integers(0, 255),
        st.integers(0, 255),
        st.integers(0, 255),
        st.integers(0, 2**32 - 1),
        st.integers(0, 2**32 - 1),
        st.integers(0, 2**64 - 1),
        st.integers(0, 2**64 - 1),
    ),
    st.binary(max_size=64),
)
def test_a_correct_checksum_is_not_enough(head: tuple[int, ...], body: bytes) -> None:
    """Never read past the end, however the header is forged."""
    try:
        read = decode(forged(head, body))
    except DatagramError:
        return
    assert len(read.positions) * 16 == len(body) or read.table is not None or not body
    assert len(read.positions) == len(read.pressures) <= MAX_FOCI


def test_invalid_focal_points_are_not_encoded() -> None:
    """Say what is wrong with focal points before they are sent."""
    with pytest.raises(ValueError, match="maximum of 64"):
        encode(
            Kind.FOCI,
            session=0,
            sequence=0,
            time=0.0,
            positions=np.zeros((65, 3)),
            pressures=np.zeros(65),
        )
    with pytest.raises(ValueError, match=r"\[K, 3\]"):
        encode(Kind.FOCI, session=0, sequence=0, time=0.0, positions=np.zeros((2, 3)))
    with pytest.raises(ValueError, match="too long"):
        encode(Kind.STATUS, session=0, sequence=0, time=0.0, table={"a": "x" * 70000})


def test_the_format_does_not_change() -> None:
    """Keep the bytes that the bridge in C++ reads."""
    data = encode(
        Kind.FOCI,
        session=0x01020304,
        sequence=5,
        time=2.0,
        modulation=Modulation.NONE,
        positions=np.array(((1.0, 2.0, 3.0),)),
        pressures=np.array((4.0,)),
    )
    assert HEAD_SIZE == 32
    assert data.hex() == (
        "54434650" + "01010100" + "04030201" + "01000000" + "0500000000000000" + "0094357700000000"
        "0000803f"
        + "00000040"
        + "00004040"
        + "00008040"
        + f"{zlib.crc32(data[:-4]):08x}"[6:8]
        + f"{zlib.crc32(data[:-4]):08x}"[4:6]
        + f"{zlib.crc32(data[:-4]):08x}"[2:4]
        + f"{zlib.crc32(data[:-4]):08x}"[0:2]
    )
