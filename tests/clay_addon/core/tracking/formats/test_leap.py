# SPDX-License-Identifier: GPL-3.0-or-later
"""The Leap service's JSON and recordings of it, valid and corrupt."""

import copy
import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.formats.leap import LeapHands, read_leap_file
from tactile_clay.clay_addon.core.tracking.protocol.joints import (
    FINGERS,
    PARENTS,
    WRIST,
    reference_hand,
)
from tactile_clay.clay_addon.core.tracking.protocol.packet import encode
from tactile_clay.solver.geometry.rotations import angles_between, matrices_from_quaternions
from tactile_clay.tests.clay_addon.core.tracking.hands import flat_hand


def leap_hand(
    side: str = "right", identity: int = 7, at: Any = (0.0, 0.2, 0.0), confidence: float = 0.9
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """A flat hand in the service's format, and its fingers."""
    points = (flat_hand(side, at)[:, :3] * 1000.0).tolist()
    entry = {
        "id": identity,
        "type": side,
        "confidence": confidence,
        "direction": [0.0, 0.0, -1.0],
        "palmNormal": [0.0, -1.0, 0.0],
        "palmPosition": points[0],
    }
    pointables = []
    for kind, finger in enumerate(FINGERS):
        keys = ("mcpPosition", "pipPosition", "dipPosition", "tipPosition")
        places = dict(zip(keys, (points[joint] for joint in finger[-4:]), strict=True))
        pointables.append({"handId": identity, "type": kind, "width": 17.0, "tool": False} | places)
    return entry, pointables


def message(*hands: Any, timestamp: Any = 5_000_000) -> dict[str, Any]:
    """A frame of the service with these hands."""
    return {
        "id": 1,
        "timestamp": timestamp,
        "hands": [entry for entry, _ in hands],
        "pointables": [pointable for _, pointables in hands for pointable in pointables],
    }


def test_hand_is_read_in_meters_and_nanoseconds() -> None:
    """Convert millimeters and microseconds, and infer missing joints."""
    (frame,) = LeapHands().read(message(leap_hand(at=(0.1, 0.25, -0.05))))
    expected = flat_hand(at=(0.1, 0.25, -0.05))
    assert (frame.side, frame.source, frame.source_time) == ("right", "leap", 5_000_000_000)
    assert frame.confidence == pytest.approx(0.9)
    assert np.allclose(frame.positions, expected[:, :3], atol=1e-5)
    assert np.degrees(angles_between(frame.quaternions, expected[:, 3:7])).max() < 0.2
    assert not frame.tracked >> WRIST & 1
    assert frame.tracked >> 7 & 1


def test_wrist_and_metacarpals_of_newer_services_are_used() -> None:
    """Use the wrist and the metacarpals that newer services give."""
    entry, pointables = leap_hand()
    entry["wrist"] = [1.0, 195.0, 2.0]
    pointables[2]["carpPosition"] = [-3.0, 203.0, -30.0]
    (frame,) = LeapHands().read(message((entry, pointables)))
    assert np.allclose(frame.positions[WRIST], [0.001, 0.195, 0.002], atol=1e-6)
    assert np.allclose(frame.positions[11], [-0.003, 0.203, -0.03], atol=1e-6)
    assert frame.tracked >> WRIST & 1
    assert frame.tracked >> 11 & 1


def test_two_hands_keep_their_sides_and_fingers() -> None:
    """Assign each hand its own fingers."""
    hands = [leap_hand("left", 1, (-0.2, 0.2, 0.0)), leap_hand("right", 2, (0.2, 0.2, 0.0))]
    frames = {frame.side: frame for frame in LeapHands().read(message(*hands))}
    assert set(frames) == {"left", "right"}
    for side, frame in frames.items():
        x = -0.2 if side == "left" else 0.2
        assert np.abs(frame.positions[:, 0] - x).max() < 0.1


def test_of_two_hands_of_one_side_one_is_kept() -> None:
    """Keep the hand with the same id as before, or else the one with higher confidence."""
    hands = LeapHands()
    first = leap_hand("right", 1, (0.2, 0.2, 0.0), confidence=0.9)
    second = leap_hand("right", 2, (-0.2, 0.2, 0.0), confidence=0.5)
    (frame,) = hands.read(message(second, first))
    assert frame.positions[WRIST, 0] == pytest.approx(0.2, abs=1e-4)
    first[0]["confidence"] = 0.4
    (frame,) = hands.read(message(second, first))
    assert frame.positions[WRIST, 0] == pytest.approx(0.2, abs=1e-4)


@pytest.mark.parametrize(
    "greeting", [{"version": 6, "serviceVersion": "2.3.1"}, {"event": {"type": "deviceEvent"}}]
)
def test_greetings_and_events_are_skipped(greeting) -> None:
    """Skip greetings and events without counting them as rejected."""
    hands = LeapHands()
    assert hands.read(greeting) == []
    assert (hands.rejected, hands.time) == (0, None)


def paths(value: Any, path: tuple = ()) -> list[tuple]:
    """Paths to all values in a message."""
    found = [path] if path else []
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in items:
            found += paths(item, (*path, key))
    return found


MESSAGE = message(leap_hand("left", 1, (-0.2, 0.2, 0.0)), leap_hand("right", 2, (0.2, 0.2, 0.0)))
junk = st.one_of(
    st.none(),
    st.booleans(),
    st.floats(),
    st.integers(-(10**30), 10**30),
    st.text(max_size=5),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


@settings(max_examples=150)
@given(st.lists(st.tuples(st.sampled_from(paths(MESSAGE)), junk), min_size=1, max_size=4))
def test_corrupt_messages_give_only_valid_hands(changes) -> None:
    """Return only hands that can be sent, whatever values a frame contains."""
    corrupt = copy.deepcopy(MESSAGE)
    for path, value in changes:
        container: Any = corrupt
        try:
            for key in path[:-1]:
                container = container[key]
            container[path[-1]] = value
        except (TypeError, KeyError, IndexError):
            continue
    for frame in LeapHands().read(corrupt):
        encode(frame)


@given(st.recursive(junk, lambda inner: st.dictionaries(st.sampled_from(list(MESSAGE)), inner)))
def test_any_json_gives_only_valid_hands(content: Any) -> None:
    """Return only hands that can be sent from arbitrary JSON."""
    for frame in LeapHands().read(content):
        encode(frame)


# Files ------------------------------------------------------------------------------------------


def test_real_recordings_have_constant_bone_lengths(leap_recording: Path) -> None:
    """Read every frame of real recordings: finite, ascending, with one hand of human size."""
    frames = read_leap_file(leap_recording)
    times = [time for time, _ in frames]
    assert times == sorted(times)
    hands = [hands[0] for _, hands in frames]
    assert len(hands) == len(frames) > 200
    assert {hand.side for hand in hands} == {"right"}
    positions = np.array([hand.positions for hand in hands])
    assert np.isfinite(positions).all()
    bones = [joint for joint in range(26) if PARENTS[joint] >= 0]
    parents = [PARENTS[joint] for joint in bones]
    lengths = np.linalg.norm(positions[:, bones] - positions[:, parents], axis=2)
    # The device's bone lengths are constant to 0.01 mm, and inferred joints should be as rigid.
    assert np.ptp(lengths, axis=0).max() < 1e-4
    reference = reference_hand("right").positions
    typical = np.linalg.norm(reference[bones] - reference[parents], axis=1)
    assert np.all((lengths[0] > 0.6 * typical) & (lengths[0] < 1.6 * typical))


def test_real_fingers_do_not_roll(leap_recording: Path) -> None:
    """Rotate finger bones between frames hardly more than their directions change."""
    hands = [hands[0] for _, hands in read_leap_file(leap_recording)]
    quaternions = np.array([hand.quaternions for hand in hands])
    forward = -matrices_from_quaternions(quaternions)[..., 2]
    cosines = np.clip(np.sum(forward[1:] * forward[:-1], axis=-1), -1.0, 1.0)
    excess = angles_between(quaternions[1:], quaternions[:-1]) - np.arccos(cosines)
    fingers = [joint for finger in FINGERS[1:] for joint in finger[1:]]
    assert np.degrees(excess[:, fingers]).max() < 5.0
    assert np.degrees(excess[:, list(FINGERS[0])]).max() < 30.0


def test_frames_of_a_file_are_sorted(tmp_path: Path) -> None:
    """Read .json and .json.gz with frames in any order, and skip invalid ones."""
    frames = [message(leap_hand(), timestamp=time) for time in (3000, 1000, 2000)]
    content = json.dumps({"metadata": {}, "frames": [*frames, ["packed"], {"broken": 1}, None]})
    (tmp_path / "a.json").write_text(content)
    (tmp_path / "a.json.gz").write_bytes(gzip.compress(content.encode()))
    for name in ("a.json", "a.json.gz"):
        read = read_leap_file(tmp_path / name)
        assert [time for time, _ in read] == [1_000_000, 2_000_000, 3_000_000]


def test_packed_file_is_read(tmp_path: Path) -> None:
    """Read later files, which store values without keys, and fingers without a type."""
    hand_keys = ["id", "type", "direction", "palmNormal", "palmPosition", "confidence", "wrist"]
    joint_keys = ["handId", "id", "mcpPosition", "pipPosition", "dipPosition", "tipPosition"]
    names = ["timestamp", {"hands": [hand_keys]}, {"pointables": [joint_keys]}, {"box": ["size"]}]
    frames: list[Any] = [names]
    for time in (1000, 2000):
        whole = message(leap_hand("left", 1), leap_hand("right", 2, (0.3, 0.2, 0.0)))
        for pointable in whole["pointables"]:
            pointable["id"] = 10 * pointable["handId"] + pointable["type"]
        hands = [[hand.get(key) for key in hand_keys] for hand in whole["hands"]]
        fingers = [[pointable[key] for key in joint_keys] for pointable in whole["pointables"]]
        frames.append([time, hands, fingers, [[1, 2, 3]]])
    path = tmp_path / "packed.json"
    path.write_text(json.dumps({"frames": [*frames, [], [3000, 7], "broken"]}))
    read = read_leap_file(path)
    assert [(time, len(hands)) for time, hands in read] == [(1_000_000, 2), (2_000_000, 2)]
    right = next(hand for hand in read[0][1] if hand.side == "right")
    assert np.allclose(right.positions, flat_hand("right", (0.3, 0.2, 0.0))[:, :3], atol=1e-5)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not valid JSON"),
        (b'{"frames": [["timestamp"], [1], [[[]]], {}]}', "None of the 4 frames"),
        (b"{", "not valid JSON"),
        (b"[" * 100_000, "not valid JSON"),
        (b"[]", "no list of frames"),
        (b'{"frames": {}}', "no list of frames"),
        (b'{"frames": [{"hands": 3}, 7]}', "None of the 2 frames"),
        (gzip.compress(b'{"frames": []}', mtime=0)[:-9], "cannot be read"),
        (b"\x1f\x8bnot packed at all", "cannot be read"),
    ],
)
def test_invalid_file_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    """Explain what is wrong with a file."""
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(TrackingError, match=reason):
        read_leap_file(path)
