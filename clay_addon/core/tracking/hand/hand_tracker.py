# SPDX-License-Identifier: GPL-3.0-or-later
"""Follows both hands, and ignores the few frames in which a tracker swaps them."""

from __future__ import annotations

from ..protocol.joints import SIDES, WRIST
from ..protocol.packet import HandFrame
from .presence import Presence, TrackedHand

_SWAP_DISTANCE = 0.08
"""A wrist closer than this to the other hand's last position may be the other hand's [m] …"""
_JUMP_DISTANCE = 0.12
"""… if it is also farther than this from its own last position [m]."""
_MEMORY = 1.0
"""A hand last seen longer ago than this may have moved anywhere [s]."""
_MIN_SEPARATION = 0.03
"""Two wrists cannot be closer than this [m]: the tracker reports one hand twice."""
_SWAP_TIME = 250_000_000
"""A swap that lasts this long is accepted [ns]: the hands were confused before it."""


class HandTracker:
    """Follows both hands from the frames that arrive.

    A frame that puts a hand where the other one just was is ignored; the hand keeps its pose until
    the tracker finds it again. A change that lasts for a quarter of a second is accepted, and
    treated as a jump.
    """

    def __init__(self) -> None:
        """Start without hands."""
        self._hands = {side: Presence(side) for side in SIDES}
        self._doubtful_since: dict[str, int | None] = dict.fromkeys(SIDES)
        self.ignored = 0
        """Number of frames ignored because they looked like the other hand."""

    def take(self, frame: HandFrame, seen: int) -> None:
        """Process a frame of a hand seen at time ``seen`` [ns]."""
        own = self._hands[frame.side]
        if own.trusts(frame) and self._is_other_hand(frame, seen):
            self.ignored += 1
            return
        own.take(frame, seen)

    def hand(self, side: str, now: int) -> TrackedHand | None:
        """The hand of a side at time ``now`` [ns]; None if it has never been seen."""
        return self._hands[side].hand(now)

    def _is_other_hand(self, frame: HandFrame, seen: int) -> bool:
        own = self._hands[frame.side]
        other = self._hands[SIDES[1 - SIDES.index(frame.side)]]
        wrist = frame.positions[WRIST]
        # A hand lost for a moment may reappear where it was, even close to the other.
        jumped = own.age(seen) > _MEMORY or own.distance(wrist) > _JUMP_DISTANCE
        # In a swap the other hand's frames are missing too, so its last known position is compared
        # whether or not it is visible now.
        recent = other.age(seen) * 1e9 < 2 * _SWAP_TIME
        distance = other.distance(wrist)
        since = self._doubtful_since[frame.side]
        if not (recent and distance < _SWAP_DISTANCE and jumped):
            self._doubtful_since[frame.side] = None
            return False
        if since is None:
            self._doubtful_since[frame.side] = seen
            return True
        one_hand = distance < _MIN_SEPARATION and other.state(seen) == "live"
        return seen - since < _SWAP_TIME or one_hand
