# SPDX-License-Identifier: GPL-3.0-or-later
"""Two hands at once, and a tracker that takes one for the other for a few frames."""

from __future__ import annotations

from ..protocol.joints import SIDES, WRIST
from ..protocol.packet import HandFrame
from .presence import Presence, TrackedHand

_NEAR = 0.08
"""A hand this close to where the other was [m], and far from where it was itself, is doubtful."""
_FAR = 0.12
_MEMORY = 1.0
"""So long ago a hand may have been elsewhere since [s]."""
_SAME = 0.03
"""Two wrists cannot be this close [m]: one hand was taken for both."""
_PATIENCE = 250_000_000
"""A swap that lasts this long is believed [ns]: the hands were mistaken before."""


class HandTracker:
    """Follows both hands from the frames that arrive.

    A frame that puts a hand where the other one was a moment ago is set aside: the hand stays as it
    was, and goes on when the tracker has found it again. What lasts for a quarter of a second is
    believed, and counts as a jump.
    """

    def __init__(self) -> None:
        """Begin without hands."""
        self._hands = {side: Presence(side) for side in SIDES}
        self._doubtful_since: dict[str, int | None] = dict.fromkeys(SIDES)
        self.set_aside = 0
        """Frames that looked like the other hand."""

    def take(self, frame: HandFrame, seen: int) -> None:
        """Take in a frame that was seen at a time [ns]."""
        own = self._hands[frame.side]
        if own.believes(frame) and self._is_other_hand(frame, seen):
            self.set_aside += 1
            return
        own.take(frame, seen)

    def hand(self, side: str, now: int) -> TrackedHand | None:
        """A hand at a time [ns]; None before one was seen."""
        return self._hands[side].hand(now)

    def _is_other_hand(self, frame: HandFrame, seen: int) -> bool:
        own = self._hands[frame.side]
        other = self._hands[SIDES[1 - SIDES.index(frame.side)]]
        wrist = frame.positions[WRIST]
        # A hand that was lost a moment ago may come back where it was, close to the other.
        strange = own.age(seen) > _MEMORY or own.distance(wrist) > _FAR
        # A swap makes the other hand miss its frames too, so where it was when it was last seen,
        # rather than whether it is seen, tells a swap.
        recent = other.age(seen) * 1e9 < 2 * _PATIENCE
        away = other.distance(wrist)
        since = self._doubtful_since[frame.side]
        if not (recent and away < _NEAR and strange):
            self._doubtful_since[frame.side] = None
            return False
        if since is None:
            self._doubtful_since[frame.side] = seen
            return True
        return seen - since < _PATIENCE or (away < _SAME and other.state(seen) == "live")
