# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver: takes hands' datagrams from loopback without ever waiting.

Whatever arrives, it raises nothing: what is no hand is counted.
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
"""Datagrams looked at in one call: a flood must not hold Blender up."""
_BUFFER = 1 << 20
_RATE_WINDOW = 1_000_000_000


class Arrival(NamedTuple):
    """A frame that is news."""

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

    Limitations: what comes faster than it is fetched is dropped by the system, the newest first.
    Anything on this machine may send to it: it trusts a sender no further than the format goes.
    """

    def __init__(
        self, port: int = PORT, *, clock: Callable[[], int] = time.perf_counter_ns
    ) -> None:
        """Open the port.

        Args:
            port: On 127.0.0.1; 0 lets the system choose.
            clock: The time [ns].

        Raises:
            TrackingError: The port cannot be had.
        """
        self._clock = clock
        self.accepted = 0
        """Frames that were news."""
        self.dropped = 0
        """Frames that were old, double, or of a sender beside the one that is listened to."""
        self.rejected = 0
        """Datagrams that are no hand."""
        self.reasons: Counter[str] = Counter()
        """Why datagrams were rejected."""
        self._orders = {side: FrameOrder() for side in SIDES}
        self._hands: dict[str, deque[int]] = {side: deque(maxlen=1024) for side in SIDES}
        self._newest: HandFrame | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            self._socket.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            if getattr(error, "errno", None) == errno.EADDRINUSE:
                raise TrackingError(
                    f"Port {port} is in use: another Blender is tracking. Stop it there, or choose "
                    "another port here and for the sender (--port)."
                ) from error
            raise TrackingError(f"Port {port} cannot be opened ({error}).") from error

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self._socket.getsockname()
        return host, port

    @property
    def source(self) -> str:
        """The kind of tracker that the newest frame came from; empty before any."""
        return self._newest.source if self._newest else ""

    def drain(self) -> list[Arrival]:
        """Fetch what has arrived, at most 1024 datagrams.

        Returns:
            The frames that are news, in the order they are to be used in.
        """
        arrivals: list[Arrival] = []
        for _ in range(_MAX_AT_ONCE):
            try:
                # One byte more than a hand has, so that longer datagrams are told from hands.
                data, sender = self._socket.recvfrom(PACKET_SIZE + 1)
            except (BlockingIOError, InterruptedError):
                break
            except OSError as error:
                # Windows says so of a datagram longer than the buffer, and of a peer that is gone.
                if error.errno in (errno.EBADF, errno.ENOTSOCK) or self._socket.fileno() < 0:
                    break
                self._reject("not readable")
                continue
            self._sort(data, sender, arrivals)
        return arrivals

    def _sort(self, data: bytes, sender: tuple[str, int], arrivals: list[Arrival]) -> None:
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
            self._hands[frame.side].append(now)
        arrivals.append(Arrival(frame, seen))

    def _reject(self, reason: str) -> None:
        self.rejected += 1
        self.reasons[reason] += 1

    def rate(self, side: str) -> float:
        """Frames of a hand in the last second [1/s]."""
        start = self._clock() - _RATE_WINDOW
        return float(sum(moment >= start for moment in self._hands[side]))

    def latency(self, side: str) -> float | None:
        """Delay of a hand's newest frame [s]; None where the sender's clock is not this one's."""
        delay = self._orders[side].delay * 1e-9
        return delay if self._newest and 0.0 < delay < 10.0 else None

    def close(self) -> None:
        """Give the port back; a second call does nothing."""
        self._socket.close()

    def __enter__(self) -> Receiver:
        """Use it in a with statement."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it at the end."""
        self.close()
