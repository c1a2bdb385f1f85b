# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread that makes surfaces: the newest particles win, and nobody waits for it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tactile_clay.clay_addon.core.surface.worker import SurfaceWorker


class Slow:
    """Makes "surfaces" that are the first coordinate, when it is let."""

    def __init__(self) -> None:
        self.let = threading.Semaphore(0)
        self.begun = threading.Semaphore(0)
        self.made: list[float] = []

    def reconstruct(self, positions: np.ndarray, colors: np.ndarray) -> Any:
        """Wait until let, then make one; a number above 100 cannot be made."""
        self.begun.release()
        assert self.let.acquire(timeout=30)
        value = float(positions[0, 0])
        if value > 100:
            raise ValueError("too far")
        self.made.append(value)
        return value


@pytest.fixture
def slow() -> Iterator[tuple[Slow, SurfaceWorker]]:
    """A worker with what it works with, ended afterwards."""
    quick = Slow()
    worker = SurfaceWorker(quick)  # type: ignore[arg-type]
    yield quick, worker
    quick.let.release(100)
    worker.end()
    assert not worker._thread.is_alive()


def made(worker: SurfaceWorker) -> Any:
    """What was finished last."""
    return worker.finished().surface


def particles(value: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """One particle there."""
    return [(np.full((1, 3), value), np.ones((1, 4)))]


def test_newest_particles_replace_those_that_wait(slow: tuple[Slow, SurfaceWorker]) -> None:
    """Take a copy of what is offered, skip what is old, and never wait."""
    quick, worker = slow
    first = particles(1)
    worker.offer(first)
    first[0][0][:] = 9
    assert quick.begun.acquire(timeout=30)
    for value in (2, 3, 4):
        worker.offer(particles(value))
    assert worker.finished().surface is None
    assert not worker.wait(timeout=0.0)
    quick.let.release(2)
    assert worker.wait()
    assert quick.made == [1, 4]
    assert made(worker) == 4
    assert worker.seconds > 0


def test_what_goes_wrong_is_told_and_forgotten(slow: tuple[Slow, SurfaceWorker]) -> None:
    """Go on after an error, which is told until something can be made again."""
    quick, worker = slow
    quick.let.release(2)
    worker.offer(particles(101))
    assert worker.wait()
    assert worker.finished().problem == "too far"
    assert worker.finished().surface is None
    worker.offer(particles(5))
    assert worker.wait()
    assert worker.finished().problem == ""
    assert made(worker) == 5
