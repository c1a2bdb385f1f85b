# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings: exact, whole, and readable even when they were cut short."""

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
    """Frames as they come off the wire, with a gap in them."""
    noise = np.random.default_rng(5)
    for number in range(count):
        place = noise.normal(0.0, 0.1, 3)
        side = ("left", "right")[number % 2]
        frame = frame_at(number * MILLISECOND, number, side, place, active=number != 3)
        yield decode(encode(frame))


def record(path: Path, count: int = 5) -> Path:
    """Write a recording that began at some time."""
    recorder = Recorder(path)
    for number, frame in enumerate(frames(count)):
        recorder.take(frame, 777 + number * 9 * MILLISECOND)
    assert recorder.close() == path
    return path


def test_recording_gives_back_what_arrived_to_the_bit(tmp_path: Path) -> None:
    """Read the same frames at the same times as were written."""
    entries = read_recording(record(tmp_path / "a" / "hands.jsonl"))
    assert [entry.time for entry in entries] == [number * 9 * MILLISECOND for number in range(5)]
    for entry, frame in zip(entries, frames(), strict=True):
        assert encode(entry.frame) == encode(frame)


def test_recording_is_json_lines_that_people_can_read(tmp_path: Path) -> None:
    """Write a line that tells the format, then one a frame with names for everything."""
    lines = record(tmp_path / "hands.jsonl").read_text().splitlines()
    assert json.loads(lines[0]) == {"format": "tactile-clay-hands", "version": 1}
    content = json.loads(lines[2])
    assert content["side"] == "right"
    assert len(content["joints"]) == 26
    assert "joints" not in json.loads(lines[4])


def test_recording_has_its_name_once_it_is_whole(tmp_path: Path) -> None:
    """Write under another name first, which can be read too, and leave an older file alone."""
    path = tmp_path / "hands.jsonl"
    path.write_text("older")
    recorder = Recorder(path)
    for number, frame in enumerate(frames(200)):
        recorder.take(frame, number)
    assert path.read_text() == "older"
    # What a crash would leave: all but the last moment.
    partial = read_recording(tmp_path / "hands.jsonl.part")
    assert len(partial) > 100
    recorder.close()
    assert len(read_recording(path)) == 200
    assert [item.name for item in tmp_path.iterdir()] == ["hands.jsonl"]


def test_frames_stay_in_the_order_they_came_in(tmp_path: Path) -> None:
    """Keep the order of arrival where estimates of when a hand was seen go back."""
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
    """Keep no file where nothing arrived."""
    recorder = Recorder(tmp_path / "hands.jsonl")
    assert recorder.close() is None
    assert recorder.close() is None
    assert list(tmp_path.iterdir()) == []


def test_place_that_cannot_be_written_is_explained(tmp_path: Path) -> None:
    """Say so before anything is recorded."""
    (tmp_path / "file").write_text("")
    with pytest.raises(TrackingError, match="cannot be written"):
        Recorder(tmp_path / "file" / "hands.jsonl")


def test_broken_lines_are_left_out(tmp_path: Path) -> None:
    """Read what is good of a file that was cut, spoilt and joined."""
    path = record(tmp_path / "hands.jsonl")
    lines = path.read_text().splitlines()
    lines[2] = lines[2].replace('"side":"right"', '"side":"middle"')
    lines.insert(3, "{}")
    lines.insert(3, '{"time":"soon"}')
    lines.insert(3, "[" * 50_000)
    lines.append(lines[1][:-200])
    path.write_text("\n".join(lines))
    assert len(read_recording(path)) == 4


def test_compressed_recording_is_read_to_where_it_was_cut(tmp_path: Path) -> None:
    """Read .jsonl.gz, whole and cut."""
    data = gzip.compress(record(tmp_path / "hands.jsonl", 50).read_bytes())
    (tmp_path / "whole.jsonl.gz").write_bytes(data)
    (tmp_path / "cut.jsonl.gz").write_bytes(data[: len(data) // 2])
    assert len(read_recording(tmp_path / "whole.jsonl.gz")) == 50
    assert 5 < len(read_recording(tmp_path / "cut.jsonl.gz")) < 50


def test_leap_recording_is_read_as_well(leap_recording: Path) -> None:
    """Read a Leap's own file, and say in each frame which hand is not there."""
    entries = read_recording(leap_recording)
    assert entries[0].time == 0
    sides = {(entry.frame.side, entry.frame.active) for entry in entries}
    assert sides == {("right", True), ("left", False)}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "no JSON"),
        (b"\xff\xfe\x00", "no JSON"),
        (b'{"format": "tactile-clay-hands", "version": 2}\n', "version 2.*Update"),
        (b'{"format": "tactile-clay-hands", "version": 1}\n{}\n', "holds no hand"),
        (b'{"format": "else"}\n', "no list of frames"),
    ],
)
def test_file_that_is_no_recording_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    """Say what is wrong with a file, and that there is none."""
    path = tmp_path / "bad.jsonl"
    path.write_bytes(content)
    with pytest.raises(TrackingError, match=reason):
        read_recording(path)
    with pytest.raises(TrackingError, match="There is no recording"):
        read_recording(tmp_path / "nowhere.jsonl")


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), max_size=20))
def test_spoilt_bytes_do_no_harm(tmp_path: Path, changes) -> None:
    """Give frames that can be sent, or say why not, whatever bytes a file holds."""
    path = tmp_path / "hands.jsonl"
    data = bytearray(path.read_bytes() if path.exists() else record(path, 4).read_bytes())
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    spoilt = tmp_path / "spoilt.jsonl"
    spoilt.write_bytes(data)
    try:
        entries = read_recording(spoilt)
    except TrackingError:
        return
    for entry in entries:
        encode(entry.frame)
