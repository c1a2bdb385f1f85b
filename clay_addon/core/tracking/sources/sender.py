# SPDX-License-Identifier: GPL-3.0-or-later
"""Common parts of all senders: the socket to loopback, clock conversion, playback and status."""

from __future__ import annotations

import contextlib
import socket
import sys
import time
from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple, TextIO

from ..protocol.joints import SIDES
from ..protocol.packet import PORT, HandFrame, PacketError, encode
from ..protocol.receiver import LOOPBACK
from ..recording.recording import Entry, Recorder

_STATUS_INTERVAL = 1_000_000_000


class Sighting(NamedTuple):
    """What a tracker saw at one time."""

    frames: Sequence[HandFrame]
    """The hands, at most one of each side."""
    absent: Collection[str] = ()
    """Sides known to be out of view."""
    time: int | None = None
    """Time of the absence [ns]; now by default."""


def sighting(frames: Sequence[HandFrame], time: int | None = None) -> Sighting:
    """The sighting of a tracker that reports both hands at once: a missing hand is absent.

    Args:
        frames: The hands.
        time: When they were seen [ns]. An absent hand must have the same time as a present one,
            because the receiver assumes the same delay for all of a sender's frames.
    """
    present = {frame.side for frame in frames}
    return Sighting(frames, [side for side in SIDES if side not in present], time)


class Sender:
    """Sends hands to loopback, whether or not a receiver listens."""

    def __init__(
        self, port: int = PORT, *, clock: Callable[[], int] = time.perf_counter_ns
    ) -> None:
        """Open a socket to a port of 127.0.0.1."""
        self.sent = 0
        """Number of datagrams sent."""
        self.refused = 0
        """Number of invalid frames, which were not sent."""
        self._clock = clock
        self._sequence = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((LOOPBACK, port))

    def send(self, seen: Sighting) -> list[HandFrame]:
        """Send a sighting with the next sequence number.

        Returns:
            The frames that were sent.
        """
        self._sequence += 1
        moment = self._clock() if seen.time is None else seen.time
        frames = [replace(frame, sequence=self._sequence) for frame in seen.frames]
        frames += [
            HandFrame(
                side=side, source_time=moment, sequence=self._sequence, active=False, confidence=0.0
            )
            for side in seen.absent
        ]
        sent = []
        for frame in frames:
            try:
                data = encode(frame)
            except PacketError:
                self.refused += 1
                continue
            # There may be no receiver; and if the buffer is full, newer frames follow soon.
            with contextlib.suppress(OSError):
                self._socket.send(data)
            self.sent += 1
            sent.append(frame)
        return sent

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class ClockMap:
    """Converts times of a tracker's clock to this machine's, using the smallest delay observed.

    That smallest delay itself remains unknown: the latency shown is too small by it.
    """

    _DRIFT = 1e-4
    """Growth of the smallest delay per elapsed time, because clocks drift."""

    def __init__(self, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        """Start without an offset."""
        self._clock = clock
        self._offset: float | None = None
        self._before = 0

    def __call__(self, moment: int) -> int:
        """Convert a time of the tracker's clock [ns] to this machine's [ns], at most now."""
        now = self._clock()
        offset = float(now - moment)
        if self._offset is None or offset < self._offset or offset - self._offset > 1e9:
            # A second more than the smallest delay: the tracker's clock was reset.
            self._offset = offset
        else:
            self._offset += min(self._DRIFT * (now - self._before), offset - self._offset)
        self._before = now
        return min(now, round(moment + self._offset))


def replay(
    entries: Sequence[Entry],
    *,
    speed: float = 1.0,
    loop: bool = False,
    clock: Callable[[], int] = time.perf_counter_ns,
    sleep: Callable[[float], object] = time.sleep,
) -> Generator[Sighting, None, None]:
    """Play a recording.

    Args:
        entries: Its frames, sorted by time.
        speed: Playback speed; 0 plays as fast as possible.
        loop: Whether to play it repeatedly.
        clock: The time [ns].
        sleep: Waits for a number of seconds.
    """
    earliest = 0
    while True:
        start = clock()
        for index, entry in enumerate(entries):
            due = round(entry.time / speed) if speed > 0.0 else index
            remaining = start + due - clock()
            if speed > 0.0 and remaining > 0:
                sleep(remaining * 1e-9)
            # The time it is due, not when the process woke up: this keeps the recording's timing.
            moment = max(start + due, earliest)
            frame = replace(entry.frame, source_time=moment)
            earliest = moment + 1
            if frame.active:
                yield Sighting([frame])
            else:
                yield Sighting([], [frame.side], moment)
        if not loop:
            yield Sighting([], SIDES)
            return


def run(
    sightings: Iterable[Sighting],
    sender: Sender,
    *,
    recorder: Recorder | None = None,
    duration: float | None = None,
    output: TextIO | None = None,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> int:
    """Send a tracker's sightings until they end, and print the frame rates once a second.

    Args:
        sightings: The sightings, yielded as they occur.
        sender: Sends them.
        recorder: Also records what is sent.
        duration: Stop after this time [s].
        output: Stream for the frame rates; standard error by default.
        clock: The time [ns].

    Returns:
        Number of datagrams sent.

    Raises:
        TrackingError: The tracker failed, or the recording cannot be written.
    """
    output = output or sys.stderr
    start = printed = clock()
    counts = dict.fromkeys(SIDES, 0)
    for seen in sightings:
        for frame in sender.send(seen):
            counts[frame.side] += frame.active
            if recorder is not None:
                recorder.take(frame, frame.source_time)
        now = clock()
        if now - printed > _STATUS_INTERVAL:
            seconds = (now - printed) * 1e-9
            rates = [
                f"{side} {count / seconds:.0f}/s" if count else f"{side} not seen"
                for side, count in counts.items()
            ]
            print(", ".join(rates), file=output, flush=True)
            printed, counts = now, dict.fromkeys(SIDES, 0)
        if duration is not None and (now - start) * 1e-9 >= duration:
            break
    return sender.sent
