# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread that writes a take to the disk while it is recorded. It knows nothing of Blender."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from contextlib import suppress

from ..cache import CacheError


class TakeWriter:
    """Writes one thing after the other, in the order they were handed over.

    What cannot be written is tried again when the next thing comes, and at the end: a disk that was
    full for a while costs nothing but memory.
    """

    def __init__(self) -> None:
        self.problem = ""
        """Why nothing can be written at the moment; empty where all is well."""
        self._tasks: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._waiting: list[Callable[[], None]] = []
        self._lost = ""
        self._thread = threading.Thread(target=self._run, name="clay-take", daemon=True)
        self._thread.start()

    def do(self, task: Callable[[], None]) -> None:
        """Hand over something that writes; it may raise a CacheError, and is then tried again."""
        self._tasks.put(task)

    def close(self) -> None:
        """Write what is left and end the thread.

        Raises:
            CacheError: Some of it cannot be written.
        """
        self._tasks.put(None)
        self._thread.join()
        if self._waiting or self._lost:
            raise CacheError(self._lost or self.problem)

    def _run(self) -> None:
        while True:
            task = self._tasks.get()
            if task is not None:
                self._waiting.append(task)
            with suppress(CacheError):
                while self._waiting:
                    self._write(self._waiting[0])
                    del self._waiting[0]
            if task is None:
                return

    def _write(self, task: Callable[[], None]) -> None:
        try:
            task()
        except CacheError as error:
            self.problem = str(error)
            raise
        except Exception as error:
            # Nothing may end the thread, or hold up what follows, or all of that would be lost.
            self._lost = f"A part of the take was not written ({type(error).__name__}: {error})."
        self.problem = self._lost
