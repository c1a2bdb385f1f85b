# SPDX-License-Identifier: GPL-3.0-or-later
"""Background thread that writes a take to disk during the recording."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from ..storage.cache import CacheError


class TakeWriter:
    """Runs writing tasks one after another.

    A failed task is retried with the next one and at the end, so a temporarily full disk costs only
    memory.
    """

    def __init__(self) -> None:
        self.problem = ""
        """Why nothing can be written at the moment; empty if all is well."""
        self._lost = ""
        self._urgent: deque[Callable[[], None]] = deque()
        self._normal: deque[Callable[[], None]] = deque()
        self._closing = False
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="clay-take", daemon=True)
        self._thread.start()

    def do(self, task: Callable[[], None], *, first: bool = False) -> None:
        """Queue a writing task.

        Args:
            task: Retried if it raises a CacheError.
            first: Whether it runs before all waiting tasks queued without `first`.
        """
        with self._news:
            (self._urgent if first else self._normal).append(task)
            self._news.notify()

    def close(self) -> None:
        """Run the remaining tasks and end the thread.

        Raises:
            CacheError: A task failed.
        """
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join()
        if self._urgent or self._normal or self._lost:
            raise CacheError(self._lost or self.problem)

    def _run(self) -> None:
        while True:
            with self._news:
                # A failed task waits for the next one, or for the end.
                if not self._closing and (self.problem or not (self._urgent or self._normal)):
                    self._news.wait()
                closing = self._closing
            self.problem = self._lost
            while self._urgent or self._normal:
                waiting = self._urgent or self._normal
                if not self._write(waiting[0]):
                    break
                waiting.popleft()
            if closing and (self.problem or not (self._urgent or self._normal)):
                return

    def _write(self, task: Callable[[], None]) -> bool:
        try:
            task()
        except CacheError as error:
            self.problem = str(error)
            return False
        except Exception as error:
            # An error must not end the thread or block the following tasks: they would be lost too.
            self._lost = f"Part of the take was not written ({type(error).__name__}: {error})."
            self.problem = self._lost
        return True
