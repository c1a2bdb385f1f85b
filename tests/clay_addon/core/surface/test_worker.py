# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread that makes surfaces: the latest particles win, and no other thread waits."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tactile_clay.clay_addon.core.surface.worker import SurfaceWorker


class Slow:
    """Makes "surfaces", which are the first coordinate, whenever the test lets it."""

    def __init__(self) -> None:
        self.let = threading.Semaphore(0)
        self.begun = threading.Semaphore(0)
        self.made: list[float] = []

    def reconstruct(self, positions: np.ndarray, colors: np.ndarray) -> Any:
        """Wait until let, then make one, or fail for a number above 100."""
        self.begun.release()
        assert self.let.acquire(timeout=30)
        value = float(positions[0, 0])
        if value > 100:
            raise ValueError("too far")
        self.made.append(value)
        return value


@pytest.fixture
def slow() -> Iterator[tuple[Slow, SurfaceWorker]]:
    """A worker and its surface maker; the worker is ended afterwards."""
    quick = Slow()
    worker = SurfaceWorker(quick)  # type: ignore[arg-type]
    yield quick, worker
    quick.let.release(100)
    worker.end()
    assert not worker._thread.is_alive()


def made(worker: SurfaceWorker) -> Any:
    """The surface that was finished last."""
    return worker.finished().surface


def particles(value: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """A single particle whose coordinates all have the given value."""
    return [(np.full((1, 3), value), np.ones((1, 4)))]


def test_latest_particles_replace_waiting_ones(slow: tuple[Slow, SurfaceWorker]) -> None:
    """Copy offered particles, skip outdated ones, and never wait."""
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


def test_errors_are_reported_until_the_next_success(slow: tuple[Slow, SurfaceWorker]) -> None:
    """Continue after an error, and report it until a surface can be made again."""
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
