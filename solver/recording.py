# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording passes once and replaying them: launching from Python costs more than a small pass.

On a CPU with two processors each part of the particles is recorded for itself, and the two are
replayed side by side: after each pass the threads wait for each other. Both parts' sums are kept
apart and added in the same order whoever does the work, so the result is the same to the last bit.
"""

import math
import time
from collections.abc import Callable, Hashable

import warp as wp

from .particles import Particles
from .processors import helper_thread, processor_count

MOST_RECORDINGS = 64
"""Recordings kept; the oldest goes first."""
TRIAL_RUNS = 6
"""How often a recording is tried by one thread and by two, to see which is faster."""
TRIAL_INTERVAL = 400
"""Replays after which both are tried again."""


class _Recording:
    """One sequence, to be replayed by one thread or by two, whichever is faster here and now.

    A second processor that others keep busy makes two threads slower than one.
    """

    def __init__(self, alone: wp.Graph, side_by_side: list[wp.Graph]) -> None:
        self._alone = alone
        self._side_by_side = side_by_side
        self._seconds = [math.inf, math.inf]
        self._runs = 0

    def replay(self) -> None:
        """Run it."""
        if not self._side_by_side:
            wp.capture_launch(self._alone)
            return
        # Now and then the slower way gets a trial: others may have come or gone.
        trial = self._runs % TRIAL_INTERVAL
        faster = int(self._seconds[1] < self._seconds[0])
        if trial == 0:
            self._seconds = [math.inf, math.inf]
        way = int(trial >= TRIAL_RUNS) if trial < 2 * TRIAL_RUNS else faster
        self._runs += 1
        begin = time.perf_counter()
        if way == 0:
            wp.capture_launch(self._alone)
        else:
            other = helper_thread().submit(wp.capture_launch, self._side_by_side[1])
            wp.capture_launch(self._side_by_side[0])
            other.result()
        if trial < 2 * TRIAL_RUNS:
            self._seconds[way] = min(self._seconds[way], time.perf_counter() - begin)


class Recordings:
    """Runs sequences of kernel launches, recording each the first time it is seen.

    Everything that a sequence launches with is recorded as it is: arrays by address, numbers by
    value. The key must tell apart whatever can differ.

    Args:
        particles: Whose passes are recorded.
        by_part: Whether the passes are those of the particles, which threads can share.
    """

    def __init__(self, particles: Particles, *, by_part: bool = True) -> None:
        self.particles = particles
        self._side_by_side = by_part and particles.parts == 2 and processor_count() > 1
        self._recordings: dict[Hashable, _Recording] = {}
        self._seen: set[Hashable] = set()

    def run(self, key: Hashable, launch: Callable[[], None]) -> None:
        """Do what ``launch`` launches, by replay where the key is known."""
        recording = self._recordings.get(key)
        if recording is None:
            # The first time runs plainly: it loads modules, and steps of a length seen only once
            # are not worth recording.
            if key not in self._seen:
                self._seen.add(key)
                launch()
                return
            parts = (0, 1) if self._side_by_side else ()
            recording = _Recording(
                self._record(launch, None), [self._record(launch, part) for part in parts]
            )
            if len(self._recordings) >= MOST_RECORDINGS:
                del self._recordings[next(iter(self._recordings))]
            self._recordings[key] = recording
        recording.replay()

    def _record(self, launch: Callable[[], None], part: int | None) -> wp.Graph:
        with (
            self.particles.only(part),
            wp.ScopedCapture(device=self.particles.device) as capture,
        ):
            launch()
        return capture.graph

    def clear(self) -> None:
        """Forget all recordings, when arrays that they use go away."""
        self._recordings.clear()
        self._seen.clear()
