# SPDX-License-Identifier: GPL-3.0-or-later
"""When a stroke of the mouse or of the hands has ended, so that it can become an undo step."""

from __future__ import annotations

_SETTLE_SECONDS = 0.4
"""Hands that have left the clay alone for this long have ended a stroke [s]."""


class StrokeWatch:
    """Watches for the end of strokes; times are seconds of a steady clock."""

    def __init__(self) -> None:
        self._stroking = False
        self._touched_at: float | None = None

    @property
    def open(self) -> bool:
        """Whether the clay was touched since the last stroke ended."""
        return self._touched_at is not None

    def touched(self, now: float) -> None:
        """Note that something touches or changes the clay."""
        self._touched_at = now

    def has_ended(self, now: float, *, stroking: bool) -> bool:
        """Whether a stroke ended just now; each one is reported once.

        Args:
            now: The time [s].
            stroking: Whether the mouse is in the middle of a stroke.
        """
        released = self._stroking and not stroking
        self._stroking = stroking
        if self._touched_at is None or stroking:
            return False
        if released or now - self._touched_at > _SETTLE_SECONDS:
            self._touched_at = None
            return True
        return False
