# SPDX-License-Identifier: GPL-3.0-or-later
"""Deferred work: functions to call once Blender has finished what it is doing.

Inside the handlers for undo, redo and loading, Blender is still assembling the file: view layers
may point at deleted objects, and creating or removing data crashes Blender. Such a handler
schedules its work here. The next timer does it, or earlier code that needs the result calls `run`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import bpy

_logger = logging.getLogger(__name__)


class Later:
    """A queue of deferred work."""

    def __init__(self) -> None:
        self._due: dict[Callable[[], object], None] = {}

    def schedule(self, work: Callable[[], object]) -> None:
        """Schedule a function to be called soon, once however often it is scheduled until then.

        Without an interface there are no timers and no displayed view layers: it is called now.

        Args:
            work: The function; must be the same object at each call.
        """
        if bpy.app.background:
            work()
            return
        self._due[work] = None
        if not bpy.app.timers.is_registered(_run):
            # Persistent: loading a file before the timer fires must not cancel the work.
            bpy.app.timers.register(_run, first_interval=0.0, persistent=True)

    def run(self) -> None:
        """Do all scheduled work; failures are logged and do not stop the rest."""
        while self._due:
            work = next(iter(self._due))
            del self._due[work]
            try:
                work()
            except Exception:
                _logger.exception("%s failed", getattr(work, "__qualname__", work))

    def forget(self) -> None:
        """Cancel all scheduled work."""
        self._due.clear()
        if bpy.app.timers.is_registered(_run):
            bpy.app.timers.unregister(_run)


later = Later()
"""The queue of this Blender process."""


def _run() -> None:
    later.run()


def register() -> None:
    """Nothing to register: work is scheduled on demand."""


def unregister() -> None:
    """Cancel scheduled work: it belongs to the add-on."""
    later.forget()
