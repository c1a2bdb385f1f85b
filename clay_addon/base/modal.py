# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that do a long work in steps: with progress and Esc in a window, else to the end."""

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
"""Pause between two steps in a window [s]."""

_logger = logging.getLogger(__name__)


class SteppedOperator(Generic[_Step, _Result]):
    """What an operator that works in steps inherits beside Blender's own class.

    Blender makes the operator; it has no constructor.
    """

    report: Any
    stopped_text = "Stopped."
    """What is reported after Esc."""
    _steps: Generator[_Step, Any, _Result] | None = None
    _timer: bpy.types.Timer | None = None

    def begin(self, context: bpy.types.Context) -> Generator[_Step, Any, _Result]:
        """The steps; closing them stops the work where it is.

        Raises:
            TactileClayError: The work cannot begin; so may the first step.
        """
        raise NotImplementedError

    def status(self, step: _Step) -> str:
        """What the status bar says after a step."""
        raise NotImplementedError

    def stepped(self, context: bpy.types.Context) -> None:
        """Show what a step has changed."""

    def ended(self, context: bpy.types.Context) -> None:
        """Show how things are now that the work has ended, whichever way."""

    def report_result(self, result: _Result) -> None:
        """Report what was done."""
        raise NotImplementedError

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Work without a window: to the end, or to an error."""
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
        """Work in a window, a step at a time."""
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
        # The first step checks everything; an error in it ends the operator at once.
        done = self._advance(context)
        if done is not None:
            return done
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Do one step at each tick; Esc stops."""
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        return self._advance(context) or {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop, also when Blender ends the operator."""
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
        """Do a step; returns how the operator ends, None while it goes on."""
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
