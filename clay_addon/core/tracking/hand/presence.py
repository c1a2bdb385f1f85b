# SPDX-License-Identifier: GPL-3.0-or-later
"""Decides whether a hand is live, held or lost, and how strongly it may touch the clay.

A hand that is briefly not seen, or with low confidence, is held in its last pose while its contact
fades; after 0.2 s it is lost and touches nothing. A hand whose data has stayed exactly the same for
0.5 s is lost too: no real hand is that still. When a hand appears, reappears or jumps, its contact
grows from zero to full within 0.2 s.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..protocol.joints import WRIST
from ..protocol.packet import HandFrame
from .one_euro import SMOOTHING, HandFilter

State = Literal["live", "held", "lost"]

HOLD_TIME = 0.2
"""A hand not seen for this long is lost [s]."""
FROZEN_TIME = 0.5
"""A hand whose data has not changed for this long is lost [s]."""
RAMP_TIME = 0.2
"""Contact grows from zero to full in this time [s]."""
MIN_CONFIDENCE, REGAINED_CONFIDENCE = 0.3, 0.4
"""A hand below the first is distrusted until it reaches the second."""
_JUMP_DISTANCE, _MAX_SPEED = 0.1, 6.0
"""A hand has jumped if it moved farther than this [m] plus what this speed allows [m/s]."""


class TrackedHand(NamedTuple):
    """A filtered hand and its state."""

    side: str
    """Left or right."""
    state: State
    """Live: seen now. Held: unseen or distrusted for less than 0.2 s. Lost: not present."""
    contact: float
    """How strongly it touches the clay, 0 to 1."""
    positions: NDArray[np.float64]
    """Position of each joint [m], Y up, shape [26, 3]; the last known one while held or lost."""
    quaternions: NDArray[np.float64]
    """Orientation of each joint (x, y, z, w), shape [26, 4]."""
    valid: NDArray[np.bool_]
    """Which joints may be used, shape [26]."""


class Presence:
    """Follows the state of one hand. All times are in nanoseconds, on the same clock."""

    def __init__(self, side: str) -> None:
        """Start without a hand."""
        self.side = side
        self._filter = HandFilter()
        self._frame: HandFrame | None = None
        self._pose: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._seen = self._changed = self._advanced = 0
        self._raw = b""
        self._doubted = True
        self._contact = 0.0

    def take(self, frame: HandFrame, seen: int) -> None:
        """Process a frame of this hand seen at time ``seen`` [ns]."""
        if not self.trusts(frame):
            self._advance(max(seen, self._advanced))
            self._doubted = True
            return
        was_lost = self.state(seen) == "lost"
        self._advance(max(seen, self._advanced))
        self._doubted = False
        wrist = frame.positions[WRIST].astype(np.float64)
        if was_lost or self._has_jumped(wrist, seen):
            self._filter.reset()
            self._contact = 0.0
        self._pose = self._filter(
            frame.source_time, frame.positions, frame.quaternions, SMOOTHING[frame.source]
        )
        raw = frame.joints.tobytes()
        if raw != self._raw:
            self._raw, self._changed = raw, max(seen, self._changed)
        self._frame, self._seen = frame, max(seen, self._seen)

    def trusts(self, frame: HandFrame) -> bool:
        """Whether a frame shows a hand with enough confidence."""
        required = REGAINED_CONFIDENCE if self._doubted else MIN_CONFIDENCE
        return frame.usable and frame.confidence >= required

    def distance(self, wrist: NDArray[np.floating]) -> float:
        """Distance of a point from the last trusted wrist [m]; infinite without a hand."""
        if self._frame is None:
            return float("inf")
        return float(np.linalg.norm(self._frame.positions[WRIST] - wrist))

    def age(self, now: int) -> float:
        """Time since the last trusted frame [s]; infinite without a hand."""
        return float("inf") if self._frame is None else (now - self._seen) * 1e-9

    def state(self, now: int) -> State:
        """The hand's state at time ``now`` [ns]."""
        age = self.age(now)
        if age > HOLD_TIME or (now - self._changed) * 1e-9 > FROZEN_TIME:
            return "lost"
        return "held" if self._doubted or age > 0.5 * HOLD_TIME else "live"

    def hand(self, now: int) -> TrackedHand | None:
        """The hand at time ``now`` [ns]; None if it has never been seen."""
        if self._pose is None or self._frame is None:
            return None
        self._advance(now)
        valid = (self._frame.valid >> np.arange(len(self._pose[0])) & 1).astype(bool)
        return TrackedHand(self.side, self.state(now), self._contact, *self._pose, valid)

    def _has_jumped(self, wrist: NDArray[np.float64], seen: int) -> bool:
        return self.distance(wrist) > _JUMP_DISTANCE + _MAX_SPEED * max(0.0, self.age(seen))

    def _advance(self, now: int) -> None:
        """Fade or grow the contact up to time ``now`` [ns]."""
        step = max(0, now - self._advanced) * 1e-9
        self._advanced = max(now, self._advanced)
        state = self.state(now)
        if state == "lost":
            self._contact = 0.0
        elif state == "live":
            self._contact = min(1.0, self._contact + step / RAMP_TIME)
        else:
            # Full for the first half of the hold time, zero at its end.
            remaining = min(1.0, 2.0 * (1.0 - self.age(now) / HOLD_TIME))
            self._contact = min(self._contact, max(0.0, remaining))
