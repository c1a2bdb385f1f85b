# SPDX-License-Identifier: GPL-3.0-or-later
"""A tracked hand in simulated time: where the processor is too slow, it does not leap.

When clay is simulated at half of real time, a hand that is simply put where it is now moves twice
as fast as it does, and has four times the momentum: it throws clay about. So the clay meets the
hand's path as it was recorded, at the hand's own speed, and the hand that it meets lags behind the
one that is seen, by a second at most.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....solver.soft_hand.bones import BonePath

MAX_LAG = 1.0
"""How far behind the hand may be before it hurries [s]."""
CATCH_UP = 1.2
"""How much faster than recorded the hand moves while it is behind; it hides uneven frames, too."""


class Moment(NamedTuple):
    """When a pose is taken, and how fast the simulation is."""

    now: float
    """On a steady clock [s]."""
    pace: float
    """Simulated time over real time."""


class _Entry(NamedTuple):
    time: float
    bones: NDArray[np.float64]
    tracked: bool


class HandPath:
    """Plays the poses of a hand at the pace of simulated time.

    Args:
        names: Of its bones, in the order of the poses.
    """

    def __init__(self, names: tuple[str, ...] = ()) -> None:
        self.names = names
        self._last = 0.0
        self._entries: deque[_Entry] = deque()
        self._head = 0.0

    @property
    def lag(self) -> float:
        """How far behind the newest pose the hand is [s]."""
        return self._entries[-1].time - self._head if self._entries else 0.0

    def advance(
        self, moment: Moment, bones: NDArray[np.float64], tracked: bool
    ) -> tuple[NDArray[np.float64], bool]:
        """Take the hand's pose of now, and give the one for the step to come.

        Args:
            moment: Now, and the pace.
            bones: World from each bone's own coordinates, shape [B, 4, 4].
            tracked: Whether it is known where the hand is.

        Returns:
            The same for the simulation. While the hand is not tracked it has no path: it is
            where it is found again.
        """
        entry = _Entry(moment.now, bones.copy(), tracked)
        duration, self._last = (moment.now - self._last) * moment.pace, moment.now
        if not self._entries or not np.isfinite(bones).all():
            self._entries.clear()
            self._entries.append(entry)
            self._head = moment.now
            return bones, tracked
        self._entries.append(entry)
        hurry = max(CATCH_UP, self.lag / MAX_LAG * CATCH_UP)
        self._head = min(self._head + hurry * duration, moment.now)
        while len(self._entries) > 1 and self._entries[1].time <= self._head:
            self._entries.popleft()
        first = self._entries[0]
        if len(self._entries) == 1 or self._head <= first.time:
            return first.bones, first.tracked
        second = self._entries[1]
        if not (first.tracked and second.tracked):
            return first.bones, first.tracked
        share = (self._head - first.time) / (second.time - first.time)
        path = BonePath(first.bones)
        path.aim(second.bones)
        return path.poses(share)[0], True
