# SPDX-License-Identifier: GPL-3.0-or-later
"""What all senders share: the socket to loopback, the numbering, the pace, the telling."""

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

_TELL_EVERY = 1_000_000_000


class Sighting(NamedTuple):
    """What a tracker saw at one moment."""

    frames: Sequence[HandFrame]
    """The hands, at most one of each side."""
    absent: Collection[str] = ()
    """Sides of which it is known that no hand is in view."""
    time: int | None = None
    """When they were not [ns]: now by default."""


def sighting(frames: Sequence[HandFrame], time: int | None = None) -> Sighting:
    """A sighting of a tracker that tells of both hands at once: what is not there is absent.

    Args:
        frames: The hands.
        time: When they were seen [ns]. Absence must be dated as the hands are: to the receiver all
            of a sender's frames are as late as each other.
    """
    present = {frame.side for frame in frames}
    return Sighting(frames, [side for side in SIDES if side not in present], time)


class Sender:
    """Sends hands to loopback, whether anybody listens or not."""

    def __init__(
        self, port: int = PORT, *, clock: Callable[[], int] = time.perf_counter_ns
    ) -> None:
        """Open a socket to a port of 127.0.0.1."""
        self.sent = 0
        """Datagrams sent."""
        self.refused = 0
        """Frames that no receiver would take, and that were not sent."""
        self._clock = clock
        self._sequence = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((LOOPBACK, port))

    def send(self, seen: Sighting) -> list[HandFrame]:
        """Send a sighting under the next sequence number.

        Returns:
            The frames as they were sent.
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
            # Nobody may be listening yet, or any more; a full buffer drops what is old soon anyway.
            with contextlib.suppress(OSError):
                self._socket.send(data)
            self.sent += 1
            sent.append(frame)
        return sent

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class ClockMap:
    """Turns a tracker's clock into this machine's, by the least delay that was seen.

    What stays unknown is that least delay itself: the latency shown is that much too small.
    """

    _LEAK = 1e-4
    """Clocks drift: what was least may grow by so much of the time that passes."""

    def __init__(self, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        """Begin with no pair of times."""
        self._clock = clock
        self._offset: float | None = None
        self._before = 0

    def __call__(self, moment: int) -> int:
        """The time here [ns] of a moment there [ns], never after now."""
        now = self._clock()
        offset = float(now - moment)
        if self._offset is None or offset < self._offset or offset - self._offset > 1e9:
            # A second later than ever is a clock set back or a stream that began anew.
            self._offset = offset
        else:
            self._offset += min(self._LEAK * (now - self._before), offset - self._offset)
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
        entries: Its frames, in the order of their times.
        speed: How many times as fast as it was recorded; 0 is as fast as it goes.
        loop: Begin again at its end.
        clock: The time [ns].
        sleep: Waits for so many seconds.
    """
    shift = 0
    while True:
        start = clock()
        for number, entry in enumerate(entries):
            due = round(entry.time / speed) if speed > 0.0 else number
            left = start + due - clock()
            if speed > 0.0 and left > 0:
                sleep(left * 1e-9)
            # The moment it is due, not when this process was woken: the pace is the recording's.
            moment = max(start + due, shift)
            frame = replace(entry.frame, source_time=moment)
            shift = moment + 1
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
    """Send what a tracker sees until it ends, and tell once a second what that is.

    Args:
        sightings: What it sees, as it sees it.
        sender: Where it goes.
        recorder: Keeps what is sent, too.
        duration: Stop after so many seconds.
        output: Where to tell; the standard error by default.
        clock: The time [ns].

    Returns:
        Number of datagrams sent.

    Raises:
        TrackingError: The tracker is gone, or the recording cannot be written.
    """
    output = output or sys.stderr
    start = told = clock()
    counts = dict.fromkeys(SIDES, 0)
    for seen in sightings:
        for frame in sender.send(seen):
            counts[frame.side] += frame.active
            if recorder is not None:
                recorder.take(frame, frame.source_time)
        now = clock()
        if now - told > _TELL_EVERY:
            seconds = (now - told) * 1e-9
            words = [
                f"{side} {count / seconds:.0f}/s" if count else f"{side} not seen"
                for side, count in counts.items()
            ]
            print(", ".join(words), file=output, flush=True)
            told, counts = now, dict.fromkeys(SIDES, 0)
        if duration is not None and (now - start) * 1e-9 >= duration:
            break
    return sender.sent
