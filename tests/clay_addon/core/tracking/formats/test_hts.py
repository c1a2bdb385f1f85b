# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand Tracking Streamer's format, and the source that receives it."""

import socket
from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.formats.hts import HtsHands
from tactile_clay.clay_addon.core.tracking.protocol.joints import FINGERS, WRIST
from tactile_clay.clay_addon.core.tracking.protocol.packet import encode
from tactile_clay.clay_addon.core.tracking.sources.hts import hts_stream
from tactile_clay.solver.geometry.rotations import angles_between, matrices_from_quaternions
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, flat_hand

# A right hand from the app's own documentation.
DOCUMENTED = b"""\
Right wrist:, 0.2502, 1.0635, 0.2540, 0.194, -0.116, 0.094, -0.970
Right landmarks:, 0.0000, 0.0000, 0.0000, -0.0275, -0.0197, 0.0362, -0.0438, -0.0335, 0.0608, \
-0.0418, -0.0480, 0.0913, -0.0329, -0.0595, 0.1111, -0.0236, -0.0073, 0.0960, -0.0179, -0.0226, \
0.1302, -0.0150, -0.0428, 0.1435, -0.0116, -0.0633, 0.1518, -0.0017, -0.0025, 0.0956, 0.0054, \
-0.0226, 0.1329, 0.0081, -0.0456, 0.1478, 0.0100, -0.0680, 0.1589, 0.0175, -0.0065, 0.0887, \
0.0252, -0.0222, 0.1236, 0.0279, -0.0407, 0.1424, 0.0282, -0.0595, 0.1580, 0.0230, -0.0094, \
0.0341, 0.0351, -0.0137, 0.0779, 0.0433, -0.0227, 0.1061, 0.0477, -0.0342, 0.1223
"""
NOW = 5_000 * MILLISECOND
LANDMARKS = [WRIST, *(joint for finger in FINGERS for joint in finger[-4:])]


def lines(side: str, hand: np.ndarray) -> bytes:
    """A hand as the app sends it: in left-handed axes, with landmarks in the wrist's axes."""
    wrist, (x, y, z, w) = hand[WRIST, :3], hand[WRIST, 3:7]
    local = (hand[LANDMARKS, :3] - wrist) @ matrices_from_quaternions((x, y, z, w))
    values = [*(wrist * [1, 1, -1]), -x, -y, z, w]
    text = f"{side.capitalize()} wrist:, " + ", ".join(f"{value:.6f}" for value in values)
    points = (local * [1, 1, -1]).ravel()
    text += f"\n{side.capitalize()} landmarks:, " + ", ".join(f"{value:.6f}" for value in points)
    return text.encode()


@pytest.mark.parametrize("side", ["left", "right"])
def test_left_handed_axes_are_converted(side: str) -> None:
    """Read back a rotated hand that was sent in Unity's left-handed axes."""
    turn = np.array([0.3, -0.5, 0.2, 0.787]) / np.linalg.norm([0.3, -0.5, 0.2, 0.787])
    hand = flat_hand(side, (0.1, 1.2, -0.4), quaternion=turn)
    (frame,) = HtsHands().read(lines(side, hand), NOW)
    assert (frame.side, frame.source, frame.source_time) == (side, "hts", NOW)
    assert np.allclose(frame.positions[1:], hand[1:, :3], atol=2e-5)
    assert np.degrees(angles_between(frame.quaternions, hand[:, 3:7])).max() < 0.3


def test_documented_example_is_read() -> None:
    """Read the documentation's example: fingers point forward, the thumb inward."""
    (frame,) = HtsHands().read(DOCUMENTED, NOW)
    assert np.allclose(frame.positions[WRIST], [0.2502, 1.0635, -0.2540], atol=1e-6)
    axes = matrices_from_quaternions(frame.quaternions[WRIST])
    knuckle = axes.T @ (frame.positions[12] - frame.positions[WRIST])
    thumb = axes.T @ (frame.positions[2] - frame.positions[WRIST])
    assert knuckle[2] < -0.09
    assert thumb[0] < -0.02
    assert thumb[1] < 0.0


def test_newer_labels_and_head_poses_are_accepted() -> None:
    """Ignore a frame number and a time in the label, and the head's pose."""
    data = DOCUMENTED.replace(b"Right wrist:", b"Right wrist | f=17 | t=99:")
    hands = HtsHands()
    assert len(hands.read(data + b"Head pose:, 0, 1, 0, 0, 0, 0, 1\n", NOW)) == 1
    assert hands.rejected == 0


@pytest.mark.parametrize(
    "data",
    [
        b"Right wrist:, 0, 0, 0, 0, 0, 0, 2",
        b"Right wrist:, 0, 0, 0, 0, 0, 0",
        b"Right wrist:, 0, 0, nan, 0, 0, 0, 1",
        b"Right wrist:, 0, 0, 1e9, 0, 0, 0, 1",
        b"Middle wrist:, 0, 0, 0, 0, 0, 0, 1",
        b"Right elbow:, 0, 0, 0, 0, 0, 0, 1",
        b"Right wrist, 0, 0, 0, 0, 0, 0, 1",
        b"\xff\xfe\x00",
        DOCUMENTED.splitlines()[1],
        b"Left landmarks:, " + b"0, " * 63,
        b"x" * 100_000,
    ],
)
def test_bad_line_is_counted(data: bytes) -> None:
    """Count invalid lines, and landmarks without a wrist."""
    hands = HtsHands()
    assert hands.read(data, NOW) == []
    assert hands.rejected == 1


def test_landmarks_do_not_use_an_old_wrist() -> None:
    """Reject landmarks whose wrist arrived long before."""
    wrist, landmarks = DOCUMENTED.splitlines()
    hands = HtsHands()
    hands.read(wrist, NOW)
    assert hands.read(landmarks, NOW + 100 * MILLISECOND) == []
    hands.read(wrist, NOW)
    assert len(hands.read(landmarks, NOW + 10 * MILLISECOND)) == 1


@given(
    st.lists(st.tuples(st.integers(0, len(DOCUMENTED) - 1), st.integers(0, 255)), max_size=10),
    st.integers(0, len(DOCUMENTED)),
    st.permutations(range(2)),
)
def test_corrupt_text_gives_only_valid_hands(changes, cut, order) -> None:
    """Return only hands that can be sent from text that is modified, cut and reordered."""
    data = bytearray(DOCUMENTED)
    for place, value in changes:
        data[place] = value
    parts = bytes(data[:cut]).split(b"\n", 1)
    hands = HtsHands()
    for index in order:
        for frame in hands.read(parts[index] if index < len(parts) else b"", NOW):
            encode(frame)


@given(st.binary(max_size=300))
def test_noise_gives_no_hands(data: bytes) -> None:
    """Return nothing from random bytes."""
    assert HtsHands().read(data, NOW) == []


def test_stream_is_received() -> None:
    """Receive each hand over UDP, and report which one is absent."""
    with socket.socket(type=socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    stream = hts_stream("127.0.0.1", port)
    # Nothing has arrived yet, so both are absent.
    assert set(next(stream).absent) == {"left", "right"}
    with socket.socket(type=socket.SOCK_DGRAM) as app:
        for _ in range(3):
            app.sendto(lines("left", flat_hand("left")), ("127.0.0.1", port))
            app.sendto(b"garbage", ("127.0.0.1", port))
            app.sendto(lines("right", flat_hand("right")), ("127.0.0.1", port))
    seen = [frame.side for item in islice(stream, 7) for frame in item.frames]
    assert seen[:2] == ["left", "right"]
    stream.close()


def test_port_in_use_is_explained() -> None:
    """Suggest another port if this one is in use."""
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(TrackingError, match="set the same in the app"):
            next(hts_stream("127.0.0.1", other.getsockname()[1]))
