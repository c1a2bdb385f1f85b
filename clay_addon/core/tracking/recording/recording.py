# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings of hands: JSON lines, a header and then one datagram's content per line.

While being written, a recording's name ends in ``.part``; it is renamed when complete. A recording
interrupted by a crash can still be read.
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
    """When it arrived, from the first frame on [ns]."""
    frame: HandFrame
    """The frame."""


class Recorder:
    """Writes a recording while hands arrive."""

    def __init__(self, path: Path) -> None:
        """Open the ``.part`` file beside a path and write the header.

        Raises:
            TrackingError: The file cannot be created.
        """
        self.path = path
        self.count = 0
        """Number of frames written."""
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
        """Write a frame that arrived at ``time`` [ns].

        Raises:
            TrackingError: Writing failed; what was written before is kept.
        """
        if self._file is None:
            return
        self._start = time if self._start is None else self._start
        # The time when a hand was seen is an estimate that may step back slightly when it
        # improves; the order of arrival must not.
        self._time = max(self._time, time - self._start)
        try:
            self._file.write(_line(frame, self._time))
            self.count += 1
            if self.count % _FLUSH_EVERY == 0:
                self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def close(self) -> Path | None:
        """Finish the recording and rename it to its final name.

        Returns:
            Its path; None if nothing was recorded, in which case the file is deleted.

        Raises:
            TrackingError: The recording could not be completed.
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
            f"Recording failed ({error.strerror or error}); {self.count} frames are in "
            f"{self._partial}."
        )


def read_recording(path: Path) -> list[Entry]:
    """Read a recording, which may be truncated or compressed, or a LeapJS Playback recording.

    Invalid lines are skipped.

    Raises:
        TrackingError: The file cannot be read, or contains no hands.
    """
    if not path.is_file():
        raise TrackingError(f"The recording {path} does not exist.")
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
        # A truncated compressed file is readable up to the truncation.
        if not entries:
            raise TrackingError(f"{path} cannot be read ({error}).") from error
    if not any(entry.frame.active for entry in entries):
        raise TrackingError(f"{path} contains no hands.")
    entries.sort(key=lambda entry: entry.time)
    first = entries[0].time
    return [Entry(entry.time - first, entry.frame) for entry in entries]


def with_absences(sightings: Sequence[tuple[int, Sequence[HandFrame]]]) -> list[Entry]:
    """Convert a tracker's frames to entries, with an inactive frame for each hand not in view.

    Args:
        sightings: The time [ns] and the hands of each of the tracker's frames.
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
            f"The recording has version {header.get('version')}; this add-on reads version "
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
        # The shortest decimals that give back the same float32.
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
