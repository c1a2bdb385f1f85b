# SPDX-License-Identifier: GPL-3.0-or-later
"""Receives datagrams of hands from loopback without blocking.

Invalid datagrams are counted, not raised.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

from .. import TrackingError
from .frame_order import FrameOrder
from .joints import SIDES
from .packet import PACKET_SIZE, PORT, HandFrame, PacketError, decode

LOOPBACK = "127.0.0.1"
_MAX_AT_ONCE = 1024
"""Number of datagrams processed in one call, so that a flood does not stall Blender."""
_BUFFER_SIZE = 1 << 20
_RATE_WINDOW = 1_000_000_000
_MAX_DELAY = 10_000_000_000
"""A frame that seems older than this comes from another clock [ns]."""


class Arrival(NamedTuple):
    """A new frame."""

    frame: HandFrame
    """The frame."""
    seen: int
    """When the hand was seen, on the receiver's clock [ns]."""


class Receiver:
    """Listens on loopback for hands.

    Example:
        with Receiver() as receiver:
            for arrival in receiver.drain():
                print(arrival.frame.side, arrival.frame.positions[1])

    Limitations: if datagrams arrive faster than they are fetched, the system drops the newest. Any
    program on this machine may send; beyond the format nothing about a sender is verified.
    """

    def __init__(
        self, port: int = PORT, *, clock: Callable[[], int] = time.perf_counter_ns
    ) -> None:
        """Open the port.

        Args:
            port: On 127.0.0.1; 0 lets the system choose.
            clock: The time [ns].

        Raises:
            TrackingError: The port cannot be opened.
        """
        self._clock = clock
        self.accepted = 0
        """Number of new frames."""
        self.dropped = 0
        """Number of frames that were old, duplicates, or from a second sender."""
        self.rejected = 0
        """Number of datagrams that are not valid hands."""
        self.reasons: Counter[str] = Counter()
        """How many datagrams were rejected for each reason."""
        self._orders = {side: FrameOrder() for side in SIDES}
        self._arrival_times: dict[str, deque[int]] = {side: deque(maxlen=1024) for side in SIDES}
        self._newest: HandFrame | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_SIZE)
            self._socket.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            if getattr(error, "errno", None) == errno.EADDRINUSE:
                raise TrackingError(
                    f"Port {port} is in use, perhaps by another Blender that is tracking. Stop "
                    "tracking there, or choose another port here and for the sender (--port)."
                ) from error
            raise TrackingError(f"Port {port} cannot be opened ({error}).") from error

    @property
    def address(self) -> tuple[str, int]:
        """Host and port it listens on."""
        host, port = self._socket.getsockname()
        return host, port

    @property
    def source(self) -> str:
        """The kind of tracker that sent the newest frame; empty before the first."""
        return self._newest.source if self._newest else ""

    def drain(self) -> list[Arrival]:
        """Fetch the datagrams that have arrived, at most 1024.

        Returns:
            The new frames, in the order of their arrival.
        """
        arrivals: list[Arrival] = []
        for _ in range(_MAX_AT_ONCE):
            try:
                # One byte more than a hand has, so that longer datagrams are detected.
                data, sender = self._socket.recvfrom(PACKET_SIZE + 1)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as error:
                # Windows raises this for a datagram longer than the buffer, or if a peer is gone.
                if error.errno in (errno.EBADF, errno.ENOTSOCK) or self._socket.fileno() < 0:
                    break
                self._reject("not readable")
                continue
            self._process(data, sender, arrivals)
        return arrivals

    def _process(self, data: bytes, sender: tuple[str, int], arrivals: list[Arrival]) -> None:
        try:
            frame = decode(data)
        except PacketError as error:
            self._reject(str(error))
            return
        now = self._clock()
        seen = self._orders[frame.side].accept(frame, sender, now)
        if seen is None:
            self.dropped += 1
            return
        self.accepted += 1
        self._newest = frame
        if frame.active:
            self._arrival_times[frame.side].append(now)
        arrivals.append(Arrival(frame, seen))

    def _reject(self, reason: str) -> None:
        self.rejected += 1
        self.reasons[reason] += 1

    def rate(self, side: str) -> float:
        """Frame rate of a hand over the last second [1/s]."""
        start = self._clock() - _RATE_WINDOW
        return float(sum(arrived >= start for arrived in self._arrival_times[side]))

    def latency(self, side: str) -> float | None:
        """Delay of a hand's newest frame [s].

        None before this hand's first frame, or if the sender's clock differs from this one.
        """
        delay = self._orders[side].delay
        return delay * 1e-9 if delay is not None and 0 <= delay < _MAX_DELAY else None

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        self._socket.close()

    def __enter__(self) -> Receiver:
        """Return the receiver, for use in a with statement."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the receiver."""
        self.close()
