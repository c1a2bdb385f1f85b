# SPDX-License-Identifier: GPL-3.0-or-later
"""Long-running operators that work in steps: modal with progress and Esc, or blocking."""

from __future__ import annotations

import logging
from collections.abc import Generator
from typing import Any, Generic, TypeVar

import bpy

from ...solver.core.errors import TactileClayError
from .activity import Progress
from .app_handlers import redraw_views

_Step = TypeVar("_Step", bound=Progress)
_Result = TypeVar("_Result")
_TICK = 0.01
"""Timer interval between steps in a window [s]."""

_logger = logging.getLogger(__name__)


class SteppedOperator(Generic[_Step, _Result]):
    """Mix-in for a `bpy.types.Operator` that works in steps.

    It has no constructor, as Blender creates operators itself.
    """

    report: Any
    stopped_text = "Stopped."
    """Reported after Esc."""
    _steps: Generator[_Step, Any, _Result] | None = None
    _timer: bpy.types.Timer | None = None

    def begin(self, context: bpy.types.Context) -> Generator[_Step, Any, _Result]:
        """Return a generator of steps; closing it stops the work.

        Raises:
            TactileClayError: The work cannot begin; the first step may raise this too.
        """
        raise NotImplementedError

    def status(self, step: _Step) -> str:
        """Text of the status bar after a step."""
        raise NotImplementedError

    def stepped(self, context: bpy.types.Context) -> None:
        """Called after each step in a window, to update what is shown."""

    def ended(self, context: bpy.types.Context) -> None:
        """Called when work in a window ends, whether it finished, failed or was stopped."""

    def report_result(self, result: _Result) -> None:
        """Report the result."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Work without a window, until done or an error."""
        try:
            steps = self.begin(context)
            while True:
                next(steps)
        except StopIteration as finished:
            self.report_result(finished.value)
            return {"FINISHED"}
        except TactileClayError as error:
            self._report_error(error)
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Work in a window, one step per timer event."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            self._steps = self.begin(context)
        except TactileClayError as error:
            self._report_error(error)
            return {"CANCELLED"}
        manager = context.window_manager
        manager.progress_begin(0, 100)
        self._timer = manager.event_timer_add(_TICK, window=context.window)
        # The first step checks all inputs; an error in it ends the operator immediately.
        done = self._advance(context)
        if done is not None:
            return done
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Do one step per timer event; Esc stops."""
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        return self._advance(context) or {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop on Esc, or when Blender cancels the operator."""
        try:
            if self._steps is not None:
                self._steps.close()
        except TactileClayError as error:
            self._report_error(error)
        else:
            self.report({"INFO"}, self.stopped_text)
        finally:
            self._finish(context)

    def _advance(self, context: bpy.types.Context) -> set[str] | None:
        """Do one step; returns the operator's result, or None if there are more steps."""
        assert self._steps is not None
        try:
            step = next(self._steps)
        except StopIteration as finished:
            self._finish(context)
            self.report_result(finished.value)
            return {"FINISHED"}
        except TactileClayError as error:
            self._finish(context)
            self._report_error(error)
            return {"CANCELLED"}
        except BaseException:
            self._finish(context)
            raise
        self.stepped(context)
        context.window_manager.progress_update(100 * step.done // step.total)
        context.workspace.status_text_set(self.status(step))
        redraw_views()
        return None

    def _finish(self, context: bpy.types.Context) -> None:
        self._steps = None
        manager = context.window_manager
        if self._timer is not None:
            manager.event_timer_remove(self._timer)
            self._timer = None
            manager.progress_end()
        if context.workspace:
            context.workspace.status_text_set(None)
        self.ended(context)
        redraw_views()

    def _report_error(self, error: TactileClayError) -> None:
        _logger.warning("%s: %s", type(self).__name__, error)
        self.report({"ERROR"}, str(error))
