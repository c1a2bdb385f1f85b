# SPDX-License-Identifier: GPL-3.0-or-later
"""Recording passes once and replaying them: launching from Python costs more than a small pass.

On a CPU with two processors each half of the particles is recorded separately, and the two are
replayed side by side; the threads wait for each other after each pass. The sums of both halves are
kept apart and added in a fixed order, so the result is the same to the last bit with one thread.
"""

import math
import time
from collections.abc import Callable, Hashable

import warp as wp

from .particles import Particles
from .recording_lock import recording_lock
from .threads import helper_thread, processor_count

MAX_RECORDINGS = 64
"""Largest number of recordings; the oldest is dropped first."""
TRIAL_START = 24
"""Replays of a recording before one and two threads are timed: many are used less often."""
TRIAL_RUNS = 6
"""Replays that are timed with one thread and with two, to find the faster."""
TRIAL_INTERVAL = 400
"""Replays after which both are timed again."""


_Record = Callable[[Callable[[], None], int | None], wp.Graph]


class _Recording:
    """One sequence of passes, replayed by one thread or by two, whichever is currently faster.

    Two threads are slower than one if other programs keep the second processor busy. Each variant
    is recorded when it is first used, because recording costs more than launching.

    Args:
        record: Records what a function launches, for one part or for all.
        extra_threads: Extra threads to start with, 0 or 1; None if a second cannot help.
    """

    def __init__(self, record: _Record, extra_threads: int | None) -> None:
        self._record = record
        self._graphs: dict[int | None, wp.Graph] = {}
        self.extra_threads = extra_threads
        self._seconds = [math.inf, math.inf]
        self._runs = 0

    def _graph(self, part: int | None, launch: Callable[[], None]) -> wp.Graph:
        if part not in self._graphs:
            self._graphs[part] = self._record(launch, part)
        return self._graphs[part]

    def replay(self, launch: Callable[[], None]) -> None:
        """Run what ``launch`` launches."""
        if self.extra_threads is None:
            wp.capture_launch(self._graph(None, launch))
            return
        # Both are timed again now and then, because the load of the machine may have changed.
        trial = (self._runs - TRIAL_START) % TRIAL_INTERVAL
        tries = self._runs >= TRIAL_START and trial < 2 * TRIAL_RUNS
        if trial == 0:
            self._seconds = [math.inf, math.inf]
        extra_threads = int(trial >= TRIAL_RUNS) if tries else self.extra_threads
        self._runs += 1
        graphs = [self._graph(part, launch) for part in ((0, 1) if extra_threads else (None,))]
        begin = time.perf_counter()
        if extra_threads:
            other = helper_thread().submit(wp.capture_launch, graphs[1])
            wp.capture_launch(graphs[0])
            other.result()
        else:
            wp.capture_launch(graphs[0])
        if tries:
            seconds = time.perf_counter() - begin
            self._seconds[extra_threads] = min(self._seconds[extra_threads], seconds)
            if trial == 2 * TRIAL_RUNS - 1:
                self.extra_threads = int(self._seconds[1] < self._seconds[0])


class Recordings:
    """Runs sequences of kernel launches, recording each the second time it is seen.

    Recordings hold arrays by address and numbers by value, so the key must contain everything that
    can differ.

    Args:
        particles: The particles that the passes work on.
        by_part: Whether the passes go over the particles, so that threads can share them.
    """

    def __init__(self, particles: Particles, *, by_part: bool = True) -> None:
        self.particles = particles
        side_by_side = by_part and particles.parts == 2 and processor_count() > 1
        self._extra_threads: int | None = 1 if side_by_side else None
        self._recordings: dict[Hashable, _Recording] = {}
        self._seen: set[Hashable] = set()

    def run(self, key: Hashable, launch: Callable[[], None]) -> None:
        """Run what ``launch`` launches, by replay if the key is known."""
        recording = self._recordings.get(key)
        if recording is None:
            # The first time is launched: that loads modules, and a step length that occurs only
            # once is not worth recording.
            if key not in self._seen:
                self._seen.add(key)
                launch()
                return
            if len(self._recordings) >= MAX_RECORDINGS:
                del self._recordings[next(iter(self._recordings))]
            recording = self._recordings[key] = _Recording(self._record, self._extra_threads)
        recording.replay(launch)
        # The next recording starts with the variant that proved faster.
        self._extra_threads = recording.extra_threads

    def _record(self, launch: Callable[[], None], part: int | None) -> wp.Graph:
        with (
            recording_lock,
            self.particles.only(part),
            wp.ScopedCapture(device=self.particles.device) as capture,
        ):
            launch()
        return capture.graph

    def clear(self) -> None:
        """Drop all recordings, because arrays that they use were replaced."""
        self._recordings.clear()
        self._seen.clear()
