# SPDX-License-Identifier: GPL-3.0-or-later
"""Cost of an experiment's frames, over all solvers that it makes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

from tactile_clay.solver import Solver

FRAME = 1.0 / 60.0
"""Length of a frame [s]."""
WARM_UP = 4
"""Number of first steps of each solver that are not counted: they load and record passes."""


class TooExpensiveError(RuntimeError):
    """An experiment exceeded its limit of processor time."""


@dataclass
class Meter:
    """Processor time spent in `Solver.step`, over all threads of the process."""

    limit: float
    """Processor time after which to give up [s]."""
    spent: float = 0.0
    """Processor time of all steps [s]."""
    counted: float = 0.0
    """Processor time of the steps after warming up [s]."""
    frames: float = 0.0
    """Simulated time of those steps, in frames of 1/60 s."""
    particle_frames: float = 0.0
    """Number of frames times particles."""
    steps: dict[int, int] = field(default_factory=dict)
    """Number of steps of each solver so far."""

    @property
    def core_ms(self) -> float:
        """Processor milliseconds per frame."""
        return 1e3 * self.counted / self.frames if self.frames else 0.0

    @property
    def microseconds(self) -> float:
        """Processor microseconds per particle and frame."""
        return 1e6 * self.counted / self.particle_frames if self.particle_frames else 0.0

    def count(self, solver: Solver, duration: float, seconds: float) -> None:
        """Count a step.

        Raises:
            TooExpensiveError: The limit is reached.
        """
        self.spent += seconds
        done = self.steps.get(id(solver), 0)
        self.steps[id(solver)] = done + 1
        if done >= WARM_UP:
            frames = duration / FRAME
            self.counted += seconds
            self.frames += frames
            self.particle_frames += frames * solver.scene.particle_count
        if self.spent > self.limit:
            raise TooExpensiveError(f"gave up after {self.spent:.0f} s of processor time")


@contextmanager
def metered(limit: float) -> Iterator[Meter]:
    """Measure every step of any solver inside the context."""
    meter = Meter(limit)
    step = Solver.step

    def timed_step(solver: Solver, duration: float = FRAME) -> None:
        begin = time.process_time()
        step(solver, duration)
        meter.count(solver, duration, time.process_time() - begin)

    with patch.object(Solver, "step", timed_step):
        yield meter
