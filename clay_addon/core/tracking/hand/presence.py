# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a hand is there: live, held or lost, and how much of it may touch the clay.

A hand that is not seen for a moment, or badly, is frozen and fades; after 0.2 s it is lost and
touches nothing. So is one whose pose has not changed by a bit for 0.5 s: no hand is that still. A
hand that comes, comes back or jumps touches nothing at first, and all of it 0.2 s later.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..protocol.joints import WRIST
from ..protocol.packet import HandFrame
from .one_euro import SMOOTHING, HandFilter

State = Literal["live", "held", "lost"]

HOLD = 0.2
"""A hand not seen for this long is lost [s]."""
FROZEN = 0.5
"""A hand that has not changed by a bit for this long is lost [s]."""
RAMP = 0.2
"""Contact grows from nothing to all in this time [s]."""
DOUBT, TRUST = 0.3, 0.4
"""Confidence below the first is not believed until it has passed the second."""
_JUMP, _FASTEST = 0.1, 6.0
"""A hand that moves further than this [m], and that much more a second [m/s], has jumped."""


class TrackedHand(NamedTuple):
    """A hand as it is to be shown."""

    side: str
    """Left or right."""
    state: State
    """Live: seen now. Held: not seen, or badly, for less than 0.2 s. Lost: not there."""
    contact: float
    """How much of it touches the clay, 0 to 1."""
    positions: NDArray[np.float64]
    """Position of each joint [m], Y up, shape [26, 3]; the last known while held or lost."""
    quaternions: NDArray[np.float64]
    """Orientation of each joint (x, y, z, w), shape [26, 4]."""
    valid: NDArray[np.bool_]
    """Which joints may be used, shape [26]."""


class Presence:
    """Follows one hand. Times are in nanoseconds, all on one clock."""

    def __init__(self, side: str) -> None:
        """Begin without a hand."""
        self.side = side
        self._filter = HandFilter()
        self._frame: HandFrame | None = None
        self._pose: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._seen = self._changed = self._advanced = 0
        self._raw = b""
        self._doubted = True
        self._contact = 0.0

    def take(self, frame: HandFrame, seen: int) -> None:
        """Take in a frame of this hand that was seen at that time."""
        if not self.believes(frame):
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

    def believes(self, frame: HandFrame) -> bool:
        """Whether a frame shows a hand that can be trusted."""
        return frame.usable and frame.confidence >= (TRUST if self._doubted else DOUBT)

    def distance(self, wrist: NDArray[np.floating]) -> float:
        """From the newest wrist that was seen to a point [m]; infinite without a hand."""
        if self._frame is None:
            return float("inf")
        return float(np.linalg.norm(self._frame.positions[WRIST] - wrist))

    def age(self, now: int) -> float:
        """Time since the hand was last seen well [s]; infinite without a hand."""
        return float("inf") if self._frame is None else (now - self._seen) * 1e-9

    def state(self, now: int) -> State:
        """What the hand is at a time."""
        age = self.age(now)
        if age > HOLD or (now - self._changed) * 1e-9 > FROZEN:
            return "lost"
        return "held" if self._doubted or age > 0.5 * HOLD else "live"

    def hand(self, now: int) -> TrackedHand | None:
        """The hand at a time; None before one was seen."""
        if self._pose is None or self._frame is None:
            return None
        self._advance(now)
        valid = (self._frame.valid >> np.arange(len(self._pose[0])) & 1).astype(bool)
        return TrackedHand(self.side, self.state(now), self._contact, *self._pose, valid)

    def _has_jumped(self, wrist: NDArray[np.float64], seen: int) -> bool:
        return self.distance(wrist) > _JUMP + _FASTEST * max(0.0, self.age(seen))

    def _advance(self, now: int) -> None:
        """Let contact fade or grow until a time."""
        step = max(0, now - self._advanced) * 1e-9
        self._advanced = max(now, self._advanced)
        state = self.state(now)
        if state == "lost":
            self._contact = 0.0
        elif state == "live":
            self._contact = min(1.0, self._contact + step / RAMP)
        else:
            # All for the first half of the hold, none at its end.
            left = min(1.0, 2.0 * (1.0 - self.age(now) / HOLD))
            self._contact = min(self._contact, max(0.0, left))
