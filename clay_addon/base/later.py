# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that waits until Blender has finished what it is in the middle of.

Inside its handlers for undo, redo and loading, Blender is still putting the file together: view
layers may point at objects that are gone, and making or removing data there aborts Blender. Such a
handler asks here instead, and the work is done by the next timer, or by whoever needs its result
first and calls `run`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import bpy

_logger = logging.getLogger(__name__)


class Later:
    """Work that was asked for and has not been done."""

    def __init__(self) -> None:
        self._due: dict[Callable[[], object], None] = {}

    def ask(self, work: Callable[[], object]) -> None:
        """Have work done soon, once however often it is asked for meanwhile.

        Without an interface there are no timers and no view layers on the screen: it is done now.

        Args:
            work: The same function at each call.
        """
        if bpy.app.background:
            work()
            return
        self._due[work] = None
        if not bpy.app.timers.is_registered(_run):
            # A file that is loaded before the timer comes must not take the work away.
            bpy.app.timers.register(_run, first_interval=0.0, persistent=True)

    def run(self) -> None:
        """Do everything that is due; what fails is logged, and the rest is still done."""
        while self._due:
            work = next(iter(self._due))
            del self._due[work]
            try:
                work()
            except Exception:
                _logger.exception("%s failed", getattr(work, "__qualname__", work))

    def forget(self) -> None:
        """Drop everything that is due."""
        self._due.clear()
        if bpy.app.timers.is_registered(_run):
            bpy.app.timers.unregister(_run)


later = Later()
"""The work that waits in this Blender."""


def _run() -> None:
    later.run()


def register() -> None:
    """Nothing waits yet."""


def unregister() -> None:
    """Drop what waits: it belongs to the add-on."""
    later.forget()
