# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings: exact, complete, and readable even if truncated."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.tracking import TrackingError
from tactile_clay.clay_addon.core.tracking.protocol.packet import decode, encode
from tactile_clay.clay_addon.core.tracking.recording.recording import Recorder, read_recording
from tactile_clay.tests.clay_addon.core.tracking.hands import MILLISECOND, frame_at

TURN = np.array([0.3, -0.5, 0.2, 0.787])


def frames(count: int = 5):
    """Decoded frames, one of them inactive."""
    noise = np.random.default_rng(5)
    for number in range(count):
        place = noise.normal(0.0, 0.1, 3)
        side = ("left", "right")[number % 2]
        frame = frame_at(number * MILLISECOND, number, side, place, active=number != 3)
        yield decode(encode(frame))


def record(path: Path, count: int = 5) -> Path:
    """Write a recording that starts at an arbitrary time."""
    recorder = Recorder(path)
    for number, frame in enumerate(frames(count)):
        recorder.take(frame, 777 + number * 9 * MILLISECOND)
    assert recorder.close() == path
    return path


def test_recording_is_exact(tmp_path: Path) -> None:
    """Read the same frames and times that were written, bit by bit."""
    entries = read_recording(record(tmp_path / "a" / "hands.jsonl"))
    assert [entry.time for entry in entries] == [number * 9 * MILLISECOND for number in range(5)]
    for entry, frame in zip(entries, frames(), strict=True):
        assert encode(entry.frame) == encode(frame)


def test_recording_is_readable_json_lines(tmp_path: Path) -> None:
    """Write a header line with the format, then one line of named values per frame."""
    lines = record(tmp_path / "hands.jsonl").read_text().splitlines()
    assert json.loads(lines[0]) == {"format": "tactile-clay-hands", "version": 1}
    content = json.loads(lines[2])
    assert content["side"] == "right"
    assert len(content["joints"]) == 26
    assert "joints" not in json.loads(lines[4])


def test_recording_is_renamed_when_complete(tmp_path: Path) -> None:
    """Write to a .part file, which can be read too, and replace an older file only at the end."""
    path = tmp_path / "hands.jsonl"
    path.write_text("older")
    recorder = Recorder(path)
    for number, frame in enumerate(frames(200)):
        recorder.take(frame, number)
    assert path.read_text() == "older"
    # A crash would lose only the last few frames.
    partial = read_recording(tmp_path / "hands.jsonl.part")
    assert len(partial) > 100
    recorder.close()
    assert len(read_recording(path)) == 200
    assert [item.name for item in tmp_path.iterdir()] == ["hands.jsonl"]


def test_frames_stay_in_order_of_arrival(tmp_path: Path) -> None:
    """Keep the order of arrival if the estimated times step back."""
    recorder = Recorder(tmp_path / "hands.jsonl")
    for number, time in enumerate((100, 130, 120, 140)):
        recorder.take(frame_at(number, number), time)
    recorder.close()
    entries = read_recording(tmp_path / "hands.jsonl")
    assert [(entry.frame.sequence, entry.time) for entry in entries] == [
        (0, 0),
        (1, 30),
        (2, 30),
        (3, 40),
    ]


def test_recording_of_nothing_leaves_nothing(tmp_path: Path) -> None:
    """Delete the file if nothing arrived."""
    recorder = Recorder(tmp_path / "hands.jsonl")
    assert recorder.close() is None
    assert recorder.close() is None
    assert list(tmp_path.iterdir()) == []


def test_unwritable_path_is_explained(tmp_path: Path) -> None:
    """Raise before anything is recorded."""
    (tmp_path / "file").write_text("")
    with pytest.raises(TrackingError, match="cannot be written"):
        Recorder(tmp_path / "file" / "hands.jsonl")


def test_invalid_lines_are_skipped(tmp_path: Path) -> None:
    """Read the valid lines of a corrupt file."""
    path = record(tmp_path / "hands.jsonl")
    lines = path.read_text().splitlines()
    lines[2] = lines[2].replace('"side":"right"', '"side":"middle"')
    lines.insert(3, "{}")
    lines.insert(3, '{"time":"soon"}')
    lines.insert(3, "[" * 50_000)
    lines.append(lines[1][:-200])
    path.write_text("\n".join(lines))
    assert len(read_recording(path)) == 4


def test_truncated_compressed_recording_is_read(tmp_path: Path) -> None:
    """Read .jsonl.gz, complete and truncated."""
    data = gzip.compress(record(tmp_path / "hands.jsonl", 50).read_bytes())
    (tmp_path / "whole.jsonl.gz").write_bytes(data)
    (tmp_path / "cut.jsonl.gz").write_bytes(data[: len(data) // 2])
    assert len(read_recording(tmp_path / "whole.jsonl.gz")) == 50
    assert 5 < len(read_recording(tmp_path / "cut.jsonl.gz")) < 50


def test_leap_recording_is_read_too(leap_recording: Path) -> None:
    """Read a LeapJS recording, and add inactive frames for the absent hand."""
    entries = read_recording(leap_recording)
    assert entries[0].time == 0
    sides = {(entry.frame.side, entry.frame.active) for entry in entries}
    assert sides == {("right", True), ("left", False)}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "not valid JSON"),
        (b"\xff\xfe\x00", "not valid JSON"),
        (b'{"format": "tactile-clay-hands", "version": 2}\n', "version 2.*Update"),
        (b'{"format": "tactile-clay-hands", "version": 1}\n{}\n', "contains no hands"),
        (b'{"format": "else"}\n', "no list of frames"),
    ],
)
def test_invalid_file_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    """Explain what is wrong with a file, or that it does not exist."""
    path = tmp_path / "bad.jsonl"
    path.write_bytes(content)
    with pytest.raises(TrackingError, match=reason):
        read_recording(path)
    with pytest.raises(TrackingError, match="does not exist"):
        read_recording(tmp_path / "nowhere.jsonl")


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=20))
def test_corrupt_bytes_give_only_valid_frames(tmp_path: Path, changes) -> None:
    """Return only frames that can be sent, or raise, whatever bytes a file contains."""
    path = tmp_path / "hands.jsonl"
    data = bytearray(path.read_bytes() if path.exists() else record(path, 4).read_bytes())
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    corrupt = tmp_path / "corrupt.jsonl"
    corrupt.write_bytes(data)
    try:
        entries = read_recording(corrupt)
    except TrackingError:
        return
    for entry in entries:
        encode(entry.frame)
