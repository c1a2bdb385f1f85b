# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread on which a live session's solver runs. It knows nothing of Blender."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ....solver import Hand, HandContacts, MeshCollider, Solver


@dataclass(frozen=True)
class Stepped:
    """What a step came to."""

    duration: float
    """Time that was simulated [s]; 0 of a solver that was only built."""
    seconds: float
    """Time it took to compute [s]."""
    positions: NDArray[np.float32]
    """Of the particles [m], shape [N, 3]."""
    contacts: tuple[HandContacts, ...]
    """What each hand feels."""
    tool_force: float
    """Of the clay on the tools, all together [N]."""


class SolverWorker:
    """Does one thing at a time beside the main thread, which hands it over and looks in for it."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="clay-sculpt")
        self._task: Future[Stepped] | None = None
        self.since = 0.0
        """When what it does was begun, by `time.perf_counter` [s]."""

    @property
    def busy(self) -> bool:
        """Whether something is being done."""
        return self._task is not None and not self._task.done()

    def begin(self, work: Callable[[], Stepped]) -> None:
        """Begin with something; what was done before must have been taken.

        Raises:
            RuntimeError: Something else is being done, or waits to be taken.
        """
        if self._task is not None:
            raise RuntimeError("The worker has something to do already.")
        self.since = time.perf_counter()
        self._task = self._executor.submit(work)

    def take(self) -> Stepped | None:
        """What was done since the last call, if it is done; what it raised is raised here."""
        if self._task is None or not self._task.done():
            return None
        task, self._task = self._task, None
        return task.result()

    def wait(self) -> None:
        """Wait until nothing is being done."""
        if self._task is not None:
            self._task.exception()

    def close(self) -> None:
        """Let the thread end; what is being done comes to nothing."""
        self._executor.shutdown(wait=False, cancel_futures=True)


def step(
    solver: Solver, duration: float, hands: Sequence[Hand], tools: Sequence[MeshCollider]
) -> Stepped:
    """Advance a solver.

    Args:
        solver: It reaches what its colliders and hands were last told.
        duration: Time to simulate [s]; 0 only looks.
        hands: Of its scene.
        tools: Colliders of its scene.
    """
    began = time.perf_counter()
    if duration:
        solver.step(duration)
    seconds = time.perf_counter() - began
    if not duration:
        return Stepped(duration, seconds, solver.positions(), (), 0.0)
    contacts = tuple(solver.contacts(hand) for hand in hands)
    forces = [float(np.linalg.norm(solver.force_on(tool))) for tool in tools]
    return Stepped(duration, seconds, solver.positions(), contacts, sum(forces))
