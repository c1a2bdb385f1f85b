# SPDX-License-Identifier: GPL-3.0-or-later
"""Accepts the new datagrams of one hand: no old ones, duplicates, or ones of a second sender.

Also estimates the age of each. A receiver that stalls finds old datagrams in its queue, and would
show a hand as live that was seen seconds ago. The smallest delay between the sender's clock and
this one is therefore tracked, and any delay beyond it counts as the datagram's age.
"""

from __future__ import annotations

from collections.abc import Hashable

from .packet import HandFrame

SILENCE = 200_000_000
"""After this time without a new frame, another sender or a clock set back is accepted [ns]."""
_RESTART_RUN = 5
"""Number of consecutive old frames that mean that the sender has restarted."""
_WINDOW = 5_000_000_000
"""The smallest delay is taken over the last one to two windows of this length [ns], because clocks
drift."""


class FrameOrder:
    """Accepts the new frames of one hand, by sequence number and source time."""

    def __init__(self) -> None:
        self._sender: Hashable = None
        self._newest: HandFrame | None = None
        self._arrived = 0
        self._run: list[HandFrame] = []
        self._delay = _MinDelay()

    @property
    def delay(self) -> int | None:
        """Time from the newest frame's source time to its arrival [ns]; None before the first."""
        return self._arrived - self._newest.source_time if self._newest else None

    def accept(self, frame: HandFrame, sender: Hashable, now: int) -> int | None:
        """Accept a frame or not.

        Args:
            frame: The frame that arrived.
            sender: Identifies its sender, such as an address.
            now: When it arrived [ns].

        Returns:
            When the hand was seen, on the clock of ``now`` [ns]; None if the frame is rejected.
        """
        newest = self._newest
        if newest is None:
            return self._start(frame, sender, now)
        silent = now - self._arrived > SILENCE
        if sender != self._sender:
            return self._start(frame, sender, now) if silent else None
        ahead = 0 < (frame.sequence - newest.sequence) & 0xFFFFFFFF < 1 << 31
        later = frame.source_time > newest.source_time
        if ahead and frame.source_time >= newest.source_time:
            return self._take(frame, now)
        if ahead != later and (later or silent):
            # The sender's sequence restarted, or its clock was set back.
            return self._start(frame, sender, now)
        if not ahead and not later and silent and self._is_restart(frame):
            return self._start(frame, sender, now)
        return None

    def _is_restart(self, frame: HandFrame) -> bool:
        run = self._run
        if run and not (
            0 < (frame.sequence - run[-1].sequence) & 0xFFFFFFFF <= 8
            and frame.source_time > run[-1].source_time
        ):
            run.clear()
        run.append(frame)
        return len(run) >= _RESTART_RUN

    def _start(self, frame: HandFrame, sender: Hashable, now: int) -> int:
        self._sender = sender
        self._delay = _MinDelay()
        return self._take(frame, now)

    def _take(self, frame: HandFrame, now: int) -> int:
        self._newest, self._arrived = frame, now
        self._run.clear()
        delay = now - frame.source_time
        return now - (delay - self._delay.including(delay, now))


class _MinDelay:
    """The smallest delay of the last one to two windows."""

    def __init__(self) -> None:
        self._start = 0
        self._previous: int | None = None
        self._current: int | None = None

    def including(self, delay: int, now: int) -> int:
        """Add a delay, and return the smallest [ns]."""
        if self._current is None or now - self._start > _WINDOW:
            self._previous, self._current, self._start = self._current, delay, now
        self._current = min(self._current, delay)
        return self._current if self._previous is None else min(self._current, self._previous)
