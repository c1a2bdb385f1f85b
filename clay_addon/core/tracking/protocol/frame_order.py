# SPDX-License-Identifier: GPL-3.0-or-later
"""Which datagrams of one hand are news: neither old, nor double, nor another sender's.

Also how late each is. A receiver that stalls finds old datagrams waiting for it, and would take a
hand for live that was seen seconds ago. So the least delay between a sender's clock and this one is
kept, and what a datagram is later than that counts as its age.
"""

from __future__ import annotations

from collections.abc import Hashable

from .packet import HandFrame

SILENCE = 200_000_000
"""After so long without news [ns] another sender may take over, or a clock be set back."""
_RESTART_RUN = 5
"""So many frames in a row, all old, are a sender that started anew."""
_WINDOW = 5_000_000_000
"""The least delay is that of the last one to two windows of this length [ns]: clocks drift."""


class FrameOrder:
    """Lets the news of one hand through, by sequence and source time."""

    def __init__(self) -> None:
        self._sender: Hashable = None
        self._newest: HandFrame | None = None
        self._arrived = 0
        self._run: list[HandFrame] = []
        self._delay = _LeastDelay()

    @property
    def delay(self) -> int:
        """By how much the newest frame's arrival came after its source time [ns]."""
        return self._arrived - self._newest.source_time if self._newest else 0

    def accept(self, frame: HandFrame, sender: Hashable, now: int) -> int | None:
        """Decide about a frame.

        Args:
            frame: What arrived.
            sender: Who sent it, such as an address.
            now: When it arrived [ns].

        Returns:
            When the hand was seen, on the clock of ``now`` [ns]; None for a frame to be dropped.
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
            # Counting anew, or on a clock set back.
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
        self._delay = _LeastDelay()
        return self._take(frame, now)

    def _take(self, frame: HandFrame, now: int) -> int:
        self._newest, self._arrived = frame, now
        self._run.clear()
        delay = now - frame.source_time
        return now - (delay - self._delay.including(delay, now))


class _LeastDelay:
    """The least of the delays of the last while."""

    def __init__(self) -> None:
        self._since = 0
        self._before: int | None = None
        self._least: int | None = None

    def including(self, delay: int, now: int) -> int:
        """Take in a delay, and return the least [ns]."""
        if self._least is None or now - self._since > _WINDOW:
            self._before, self._least, self._since = self._least, delay, now
        self._least = min(self._least, delay)
        return self._least if self._before is None else min(self._least, self._before)
