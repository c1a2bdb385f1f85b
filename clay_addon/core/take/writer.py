# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread that writes a take to the disk while it is recorded."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from ..storage.cache import CacheError


class TakeWriter:
    """Writes one task after another.

    What cannot be written is tried again with the next task and at the end, so a disk that is full
    for a while costs only memory.
    """

    def __init__(self) -> None:
        self.problem = ""
        """Why nothing can be written now; empty if all is well."""
        self._lost = ""
        self._first: deque[Callable[[], None]] = deque()
        self._others: deque[Callable[[], None]] = deque()
        self._closing = False
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="clay-take", daemon=True)
        self._thread.start()

    def do(self, task: Callable[[], None], *, first: bool = False) -> None:
        """Hand over a task that writes.

        Args:
            task: If it raises a CacheError, it is tried again.
            first: Whether it goes before all waiting tasks that were not handed over so.
        """
        with self._news:
            (self._first if first else self._others).append(task)
            self._news.notify()

    def close(self) -> None:
        """Write what is left and end the thread.

        Raises:
            CacheError: Some of it cannot be written.
        """
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join()
        if self._first or self._others or self._lost:
            raise CacheError(self._lost or self.problem)

    def _run(self) -> None:
        while True:
            with self._news:
                # A task that failed waits for the next one, or for the end.
                if not self._closing and (self.problem or not (self._first or self._others)):
                    self._news.wait()
                closing = self._closing
            self.problem = self._lost
            while self._first or self._others:
                waiting = self._first or self._others
                if not self._write(waiting[0]):
                    break
                waiting.popleft()
            if closing and (self.problem or not (self._first or self._others)):
                return

    def _write(self, task: Callable[[], None]) -> bool:
        try:
            task()
        except CacheError as error:
            self.problem = str(error)
            return False
        except Exception as error:
            # An error must not end the thread or hold up what follows, which would then be lost.
            self._lost = f"A part of the take was not written ({type(error).__name__}: {error})."
            self.problem = self._lost
        return True
