# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings of hands: JSON lines, one datagram's content a line, after a line that says so.

While it is written a recording has ``.part`` after its name; it gets its name when it is whole.
What was written before a crash can be read all the same.
"""

from __future__ import annotations

import gzip
import json
import os
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from .. import TrackingError
from ..formats.leap import read_leap_file
from ..protocol.joints import JOINT_COUNT, SIDES
from ..protocol.packet import HandFrame, PacketError, decode, encode

FORMAT = "tactile-clay-hands"
_HEADER = {"format": FORMAT, "version": 1}
_FLUSH_EVERY = 64


class Entry(NamedTuple):
    """A frame of a recording."""

    time: int
    """When it arrived, since the first [ns]."""
    frame: HandFrame
    """The frame."""


class Recorder:
    """Writes a recording while hands arrive."""

    def __init__(self, path: Path) -> None:
        """Begin to write beside a path.

        Raises:
            TrackingError: The file cannot be made.
        """
        self.path = path
        self.count = 0
        """Frames written."""
        self._start: int | None = None
        self._time = 0
        self._partial = path.with_name(path.name + ".part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[str] | None = self._partial.open("w", encoding="utf-8")
            self._file.write(json.dumps(_HEADER) + "\n")
        except OSError as error:
            raise TrackingError(
                f"{path} cannot be written ({error.strerror or error}). Choose another place."
            ) from error

    def take(self, frame: HandFrame, time: int) -> None:
        """Write a frame that arrived at a time [ns].

        Raises:
            TrackingError: The file cannot be written any more; what is in it stays.
        """
        if self._file is None:
            return
        self._start = time if self._start is None else self._start
        # When a hand was seen is an estimate, which a better one may set back by a little; the
        # order of arrival is none.
        self._time = max(self._time, time - self._start)
        try:
            self._file.write(_line(frame, self._time))
            self.count += 1
            if self.count % _FLUSH_EVERY == 0:
                self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def close(self) -> Path | None:
        """End the recording and give it its name.

        Returns:
            Its path; None where nothing was recorded, and nothing stays.

        Raises:
            TrackingError: It could not be written to its end.
        """
        if self._file is None:
            return self.path if self.count else None
        file, self._file = self._file, None
        try:
            with file:
                file.flush()
                os.fsync(file.fileno())
            if not self.count:
                self._partial.unlink()
                return None
            self._partial.replace(self.path)
        except OSError as error:
            raise self._failed(error) from error
        return self.path

    def _failed(self, error: OSError) -> TrackingError:
        return TrackingError(
            f"The recording could not be written on ({error.strerror or error}); {self.count} "
            f"frames are in {self._partial}."
        )


def read_recording(path: Path) -> list[Entry]:
    """Read a recording, also one that was cut short or compressed, or a Leap recording.

    Lines that are no hand are left out.

    Raises:
        TrackingError: The file cannot be read, or holds no hand.
    """
    if not path.is_file():
        raise TrackingError(f"There is no recording {path}.")
    entries: list[Entry] = []
    try:
        lines = _lines(path)
        if not _is_header(next(lines, "")):
            return _leap_entries(path)
        for line in lines:
            entry = _entry(line)
            if entry is not None:
                entries.append(entry)
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        # A compressed file that was cut short is good up to there.
        if not entries:
            raise TrackingError(f"{path} cannot be read ({error}).") from error
    if not any(entry.frame.active for entry in entries):
        raise TrackingError(f"{path} holds no hand.")
    entries.sort(key=lambda entry: entry.time)
    first = entries[0].time
    return [Entry(entry.time - first, entry.frame) for entry in entries]


def with_absences(sightings: Sequence[tuple[int, Sequence[HandFrame]]]) -> list[Entry]:
    """Entries of a tracker's frames, with a hand that is not there said to be so.

    Args:
        sightings: The time [ns] and the hands of each frame.
    """
    entries: list[Entry] = []
    start = sightings[0][0] if sightings else 0
    for time, frames in sightings:
        present = {frame.side for frame in frames}
        entries.extend(Entry(time - start, frame) for frame in frames)
        entries.extend(
            Entry(
                time - start, HandFrame(side=side, source_time=time, active=False, confidence=0.0)
            )
            for side in SIDES
            if side not in present
        )
    return entries


def _leap_entries(path: Path) -> list[Entry]:
    return with_absences([(time, hands) for time, hands in read_leap_file(path)])


def _lines(path: Path) -> Iterator[str]:
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
    if packed:
        with gzip.open(path, "rt", encoding="utf-8", errors="replace") as lines:
            yield from lines
    else:
        with path.open(encoding="utf-8", errors="replace") as lines:
            yield from lines


def _is_header(line: str) -> bool:
    try:
        header = json.loads(line)
    except (ValueError, RecursionError):
        return False
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        return False
    if header.get("version") != _HEADER["version"]:
        raise TrackingError(
            f"The recording is of version {header.get('version')}; this add-on reads version "
            f"{_HEADER['version']}. Update the add-on."
        )
    return True


def _line(frame: HandFrame, time: int) -> str:
    content: dict[str, Any] = {
        "time": time,
        "side": frame.side,
        "sequence": frame.sequence,
        "source_time": frame.source_time,
        "source": frame.source,
        "active": frame.active,
        "confidence": float(str(np.float32(frame.confidence))),
        "valid": frame.valid,
        "tracked": frame.tracked,
    }
    if frame.active:
        # The shortest decimals that give the same 32 bits back.
        content["joints"] = [[float(str(value)) for value in joint] for joint in frame.joints]
    return json.dumps(content, separators=(",", ":")) + "\n"


def _entry(line: str) -> Entry | None:
    try:
        content = json.loads(line)
        time = content.pop("time")
        joints = content.pop("joints", None)
        if joints is not None:
            content["joints"] = np.array(joints, np.float32).reshape(JOINT_COUNT, 8)
        if not isinstance(time, int) or isinstance(time, bool) or not 0 <= time < 1 << 62:
            return None
        return Entry(time, decode(encode(HandFrame(**content))))
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError, RecursionError):
        return None
    except PacketError:
        return None
