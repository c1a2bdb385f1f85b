# SPDX-License-Identifier: GPL-3.0-or-later
"""How long each part of a live frame takes."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median

_RECENT = 120
"""Number of recent values that count."""


class FrameBudget:
    """Recent times of the parts of a frame."""

    def __init__(self) -> None:
        self._seconds: defaultdict[str, deque[float]] = defaultdict(lambda: deque(maxlen=_RECENT))

    def took(self, part: str, seconds: float) -> None:
        """Note how long a part took [s]."""
        self._seconds[part].append(seconds)

    @contextmanager
    def measured(self, part: str) -> Iterator[None]:
        """Measure and note the time spent inside the context."""
        began = time.perf_counter()
        yield
        self.took(part, time.perf_counter() - began)

    def milliseconds(self) -> dict[str, float]:
        """The median of each part [ms]."""
        return {part: 1e3 * median(seconds) for part, seconds in self._seconds.items()}
