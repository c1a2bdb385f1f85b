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
    """The result of a step."""

    duration: float
    """Time that was simulated [s]; 0 for a solver that was only built."""
    seconds: float
    """Time it took to compute [s]."""
    positions: NDArray[np.float32]
    """Of the particles [m], shape [N, 3]."""
    contacts: tuple[HandContacts, ...]
    """Contacts on each hand."""
    tool_force: float
    """Total force of the clay on the tools [N]."""


class SolverWorker:
    """Runs one task at a time on its own thread; the main thread polls for the result."""

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="clay-sculpt")
        self._task: Future[Stepped] | None = None
        self.since = 0.0
        """When the task began, by `time.perf_counter` [s]."""

    @property
    def busy(self) -> bool:
        """Whether a task is running."""
        return self._task is not None and not self._task.done()

    def begin(self, work: Callable[[], Stepped]) -> None:
        """Begin a task, after the result of the last one was taken.

        Raises:
            RuntimeError: A task is running, or its result waits to be taken.
        """
        if self._task is not None:
            raise RuntimeError("The worker already has a task.")
        self.since = time.perf_counter()
        self._task = self._executor.submit(work)

    def take(self) -> Stepped | None:
        """The result of the task once it is done, else None; what it raised is raised here."""
        if self._task is None or not self._task.done():
            return None
        task, self._task = self._task, None
        return task.result()

    def wait(self) -> None:
        """Wait until no task is running."""
        if self._task is not None:
            self._task.exception()

    def close(self) -> None:
        """Let the thread end after the running task, whose result is dropped."""
        self._executor.shutdown(wait=False, cancel_futures=True)


def step(
    solver: Solver, duration: float, hands: Sequence[Hand], tools: Sequence[MeshCollider]
) -> Stepped:
    """Advance a solver.

    Args:
        solver: Its colliders and hands move to where they were last placed.
        duration: Time to simulate [s]; 0 only reads the state.
        hands: Those of its scene.
        tools: Tool colliders of its scene.
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
