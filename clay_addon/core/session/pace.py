# SPDX-License-Identifier: GPL-3.0-or-later
"""How much time to simulate next, so that the clay keeps up with real time.

If the processor is too slow, simulated time falls behind. This is reported, and never caught up
with: steps that grow because the last one took long would take even longer.
"""

from __future__ import annotations

import math
from collections import deque

STEP_SECONDS = 1.0 / 60.0
"""Steps are whole multiples of this [s]."""
_BUDGET = 0.05
"""Longest computing time of a step that covers several frames [s]."""
_MAX_STEP_SECONDS = 0.25
"""Most time that a step may cover [s]: hands and tools move evenly within a step."""
_WINDOW = 1.0
"""Time over which the factor is measured [s]."""
_MEMORY = 0.8
"""Weight of earlier steps in the running mean of the cost."""


class Pace:
    """Keeps simulated time in step with a steady clock; all times are in seconds."""

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
        # While Blender draws, the solver may work, and should if that takes long.
        self._passed = _mean(self._passed, passed)
        self._last = now
        # A little less, so that a slow solver does not mistake its own time for Blender's.
        budget = max(_BUDGET, 0.9 * self._passed)
        affordable = budget / self._cost if self._cost > 0.0 else STEP_SECONDS
        most = max(STEP_SECONDS, min(affordable, _MAX_STEP_SECONDS))
        # Time that cannot be simulated is dropped.
        self._owed = min(self._owed, most + 0.5 * STEP_SECONDS)
        # A timer that fires at the same rate would otherwise skip every other step.
        steps = math.floor(min(self._owed, most) / STEP_SECONDS + 0.25)
        duration = steps * STEP_SECONDS
        self._owed -= duration
        if duration:
            self.simulated += duration
            self._steps.append((now, duration))
            # One step from before the window stays: the window begins with it.
            while len(self._steps) > 1 and self._steps[1][0] < now - _WINDOW:
                self._steps.popleft()
        return duration

    def took(self, duration: float, seconds: float) -> None:
        """Note how long a step took to compute.

        Args:
            duration: Time that was simulated [s].
            seconds: Time that it took [s].
        """
        cost = seconds / duration
        if not self.started:
            # The first compiles the kernels, so its time says nothing about the others.
            self.started = True
            return
        self._cost = _mean(self._cost, cost) if self._cost else cost

    def pause(self) -> None:
        """Do not count the time until the next step."""
        self._last = None
        self._owed = 0.0
        self._steps.clear()

    def factor(self, now: float) -> float:
        """Simulated time over real time in the last second; 1 before the first step."""
        if not self._steps:
            return 1.0
        begun, last = self._steps[-1]
        # The newest step counts in full, and lasts at least until now.
        whole = max(now, begun + last) - self._steps[0][0]
        return min(1.0, sum(duration for _, duration in self._steps) / whole)


def _mean(before: float, value: float) -> float:
    return _MEMORY * before + (1.0 - _MEMORY) * value
