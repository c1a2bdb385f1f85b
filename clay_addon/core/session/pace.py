# SPDX-License-Identifier: GPL-3.0-or-later
"""How much time to simulate next, so that the clay keeps up with the clock on the wall.

Where the processor is too slow, simulated time falls behind, which is said and never made up for:
steps that grow because the last one took long would take longer still.
"""

from __future__ import annotations

import math
from collections import deque

STEP_SECONDS = 1.0 / 60.0
"""Steps are whole multiples of this [s]."""
_BUDGET = 0.05
"""A step that covers much time shall not take longer than this to compute [s]."""
_LONGEST = 0.25
"""Nor shall it cover more than this [s]: hands and tools move evenly within a step."""
_WINDOW = 1.0
"""The factor is that of the last second [s]."""
_MEMORY = 0.8
"""How much of what a step cost before counts beside what it cost now."""


class Pace:
    """Keeps simulated time beside the clock; times in seconds, by any steady clock."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._owed = 0.0
        self._cost = 0.0
        self._passed = 0.0
        self._steps: deque[tuple[float, float]] = deque()
        self.simulated = 0.0
        """Time simulated so far [s]."""
        self.started = False
        """Whether a step has been computed."""

    def next(self, now: float) -> float:
        """Time to simulate now [s], a multiple of `STEP_SECONDS`; 0 while none is due."""
        if self._last is None:
            self._last = now - STEP_SECONDS
        passed = max(0.0, now - self._last)
        self._owed += passed
        # While Blender draws, the solver may work, and should where that takes long.
        self._passed = _mean(self._passed, passed)
        self._last = now
        # A little less than that, so that a slow solver does not take its own time for Blender's.
        budget = max(_BUDGET, 0.9 * self._passed)
        affordable = budget / self._cost if self._cost > 0.0 else STEP_SECONDS
        most = max(STEP_SECONDS, min(affordable, _LONGEST))
        # What cannot be simulated is let go.
        self._owed = min(self._owed, most + 0.5 * STEP_SECONDS)
        # A timer that fires at the same rate would otherwise skip every other step.
        steps = math.floor(min(self._owed, most) / STEP_SECONDS + 0.25)
        duration = steps * STEP_SECONDS
        self._owed -= duration
        if duration:
            self.simulated += duration
            self._steps.append((now, duration))
            # One from before the window stays: it is what the window begins with.
            while len(self._steps) > 1 and self._steps[1][0] < now - _WINDOW:
                self._steps.popleft()
        return duration

    def took(self, duration: float, seconds: float) -> None:
        """Tell how long a step took to compute.

        Args:
            duration: Time that was simulated [s].
            seconds: Time that took [s].
        """
        cost = seconds / duration
        if not self.started:
            # The first compiles the kernels, and says nothing of the others.
            self.started = True
            return
        self._cost = _mean(self._cost, cost) if self._cost else cost

    def pause(self) -> None:
        """Let the time until the next step not count."""
        self._last = None
        self._owed = 0.0
        self._steps.clear()

    def factor(self, now: float) -> float:
        """Simulated time over that of the clock, of the last second; 1 before there was any."""
        if not self._steps:
            return 1.0
        begun, last = self._steps[-1]
        # The newest counts as whole, and takes as long as it has been at work by now.
        whole = max(now, begun + last) - self._steps[0][0]
        return min(1.0, sum(duration for _, duration in self._steps) / whole)


def _mean(before: float, value: float) -> float:
    return _MEMORY * before + (1.0 - _MEMORY) * value
