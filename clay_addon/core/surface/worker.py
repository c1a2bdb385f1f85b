# SPDX-License-Identifier: GPL-3.0-or-later
"""A thread that makes surfaces of the latest particles, so that no other thread waits."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ....solver.core.recording_lock import recording_lock

if TYPE_CHECKING:
    from .quick.surface import QuadSurface, QuickSurface

Part = tuple[NDArray[np.floating], NDArray[np.floating]]
"""Positions, shape [N, 3], and linear RGBA, shape [N, 4], of a piece of clay."""

_SETTLED_SECONDS = 0.25
"""Without new particles for this long, the clay counts as settled [s]."""


@dataclass(frozen=True)
class Finished:
    """The latest result of a worker."""

    surface: QuadSurface | None
    """The latest surface, the same object as long as the clay does not move; None if it failed, or
    none was requested."""
    problem: str
    """What went wrong; empty if nothing did."""
    settled: bool
    """Whether the clay is known not to have moved since."""


class SurfaceWorker:
    """Reconstructs the surface of the latest particles on its own thread.

    Args:
        quick: Makes the surfaces; must not be used elsewhere.
    """

    def __init__(self, quick: QuickSurface) -> None:
        self._quick = quick
        self._condition = threading.Condition()
        self._offered: tuple[Part, ...] | None = None
        self._finished: QuadSurface | None = None
        self._problem = ""
        self._busy = self._ended = self._still = False
        self._offered_at = 0.0
        self.seconds = 0.0
        """Running average of the time to make a surface, without unchanged ones [s]."""
        self._thread = threading.Thread(target=self._run, name="clay surface", daemon=True)
        self._thread.start()

    def offer(self, parts: Sequence[Part]) -> None:
        """Request a surface of new particles, which replace those still waiting.

        Args:
            parts: Pieces of clay; their arrays are copied.
        """
        copies = tuple((np.array(x, np.float32), np.array(c, np.float32)) for x, c in parts)
        with self._condition:
            self._offered, self._offered_at = copies, time.monotonic()
            self._condition.notify_all()

    def finished(self) -> Finished:
        """The latest result, without waiting."""
        with self._condition:
            idle = self._offered is None and not self._busy
            settled = idle and time.monotonic() - self._offered_at > _SETTLED_SECONDS
            return Finished(self._finished, self._problem, self._still or settled)

    def wait(self, timeout: float = 60.0) -> bool:
        """Wait until all requests are done; returns whether that was within the timeout [s]."""
        with self._condition:
            return self._condition.wait_for(
                lambda: self._ended or (self._offered is None and not self._busy), timeout
            )

    def end(self) -> None:
        """End the thread, after the surface in progress."""
        with self._condition:
            self._ended = True
            self._condition.notify_all()
        self._thread.join(5.0)

    def _run(self) -> None:
        while True:
            with self._condition:
                self._busy = False
                self._condition.notify_all()
                self._condition.wait_for(lambda: self._ended or self._offered is not None)
                if self._ended:
                    return
                parts, self._offered = self._offered, None
                self._busy = True
            began = time.perf_counter()
            surface, problem = self._surface_of(parts or ())
            seconds = time.perf_counter() - began
            with self._condition:
                self._still = surface is self._finished
                if not self._still:
                    # Averaged, so that a single delay has little effect.
                    share = 0.3 if self.seconds else 1.0
                    self.seconds += share * (seconds - self.seconds)
                self._finished, self._problem = surface, problem

    def _surface_of(self, parts: Sequence[Part]) -> tuple[QuadSurface | None, str]:
        try:
            positions = np.concatenate([part[0] for part in parts] or [np.empty((0, 3))])
            colors = np.concatenate([part[1] for part in parts] or [np.empty((0, 4))])
            with recording_lock:
                return self._quick.reconstruct(positions, colors), ""
        except (ValueError, RuntimeError, MemoryError) as error:
            return None, str(error)
