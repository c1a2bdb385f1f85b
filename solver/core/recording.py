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
from .recording_lock import recording_lock
from .threads import helper_thread, processor_count

MAX_RECORDINGS = 64
"""Recordings kept; the oldest goes first."""
TRIAL_START = 24
"""Replays of a recording before both ways are tried: many recordings are not used that often."""
TRIAL_RUNS = 6
"""How often a recording is tried by one thread and by two, to see which is faster."""
TRIAL_INTERVAL = 400
"""Replays after which both are tried again."""


_Record = Callable[[Callable[[], None], int | None], wp.Graph]


class _Recording:
    """One sequence, to be replayed by one thread or by two, whichever is faster here and now.

    A second processor that others keep busy makes two threads slower than one. Each way is recorded
    when it is first gone: recording costs more than launching.

    Args:
        record: Records what a function launches, for a part alone or for all.
        way: Threads less one to begin with; None where there is only one.
    """

    def __init__(self, record: _Record, way: int | None) -> None:
        self._record = record
        self._graphs: dict[int | None, wp.Graph] = {}
        self.way = way
        self._seconds = [math.inf, math.inf]
        self._runs = 0

    def _graph(self, part: int | None, launch: Callable[[], None]) -> wp.Graph:
        if part not in self._graphs:
            self._graphs[part] = self._record(launch, part)
        return self._graphs[part]

    def replay(self, launch: Callable[[], None]) -> None:
        """Do what ``launch`` launches."""
        if self.way is None:
            wp.capture_launch(self._graph(None, launch))
            return
        # Now and then both ways are tried: others may have come or gone.
        trial = (self._runs - TRIAL_START) % TRIAL_INTERVAL
        tries = self._runs >= TRIAL_START and trial < 2 * TRIAL_RUNS
        if trial == 0:
            self._seconds = [math.inf, math.inf]
        way = int(trial >= TRIAL_RUNS) if tries else self.way
        self._runs += 1
        graphs = [self._graph(part, launch) for part in ((0, 1) if way else (None,))]
        begin = time.perf_counter()
        if way:
            other = helper_thread().submit(wp.capture_launch, graphs[1])
            wp.capture_launch(graphs[0])
            other.result()
        else:
            wp.capture_launch(graphs[0])
        if tries:
            self._seconds[way] = min(self._seconds[way], time.perf_counter() - begin)
            if trial == 2 * TRIAL_RUNS - 1:
                self.way = int(self._seconds[1] < self._seconds[0])


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
        side_by_side = by_part and particles.parts == 2 and processor_count() > 1
        self._way: int | None = 1 if side_by_side else None
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
            if len(self._recordings) >= MAX_RECORDINGS:
                del self._recordings[next(iter(self._recordings))]
            recording = self._recordings[key] = _Recording(self._record, self._way)
        recording.replay(launch)
        # What is recorded next begins with what has been found to be faster.
        self._way = recording.way

    def _record(self, launch: Callable[[], None], part: int | None) -> wp.Graph:
        with (
            recording_lock,
            self.particles.only(part),
            wp.ScopedCapture(device=self.particles.device) as capture,
        ):
            launch()
        return capture.graph

    def clear(self) -> None:
        """Forget all recordings, when arrays that they use go away."""
        self._recordings.clear()
        self._seen.clear()
