# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake, Resume and Free as operators, with progress and Esc in the interface."""

from collections.abc import Generator
from typing import Any

import bpy

from ..base.redraw import redraw_views
from ..core.storage.cache import CacheError
from ..playback import playback
from .bake import BakeError, BakeProgress, BakeResult, bake_steps, free

running: BakeProgress | None = None
"""How far the bake in the interface is; None while there is none."""


def duration_text(seconds: float | None) -> str:
    """A duration as people say it."""
    if seconds is None:
        return "…"
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def size_text(count: int) -> str:
    """A number of bytes as people say it."""
    size = float(count)
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            return f"{size:.3g} {unit}" if unit != "bytes" else f"{count} bytes"
        size /= 1000
    raise AssertionError


class _BakeOperator:
    """What Bake and Resume share."""

    _resume = False
    _steps: Generator[BakeProgress, bool | None, BakeResult] | None = None
    _timer: bpy.types.Timer | None = None
    report: Any

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Bake without an interface: to the end, or to an error."""
        try:
            steps = self._begin(context)
            while True:
                next(steps)
        except StopIteration as finished:
            return self._report_result(finished.value)
        except (BakeError, CacheError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Bake in the interface, a frame at a time."""
        global running
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            self._steps = self._begin(context)
        except BakeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        running = BakeProgress(context.scene.frame_current, 0, 1, None)
        # The first step checks everything; an error in it ends the operator at once.
        if not self._advance(context):
            return {"CANCELLED"}
        manager = context.window_manager
        manager.progress_begin(0, 100)
        self._timer = manager.event_timer_add(0.01, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Bake one frame at each tick; Esc stops."""
        if event.type == "ESC" and event.value == "PRESS":
            self._stop(context)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if self._advance(context):
            return {"RUNNING_MODAL"}
        return {"FINISHED"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop when Blender ends the operator."""
        self._stop(context)

    def _stop(self, context: bpy.types.Context) -> None:
        try:
            if self._steps is not None:
                self._steps.close()
        except CacheError as error:
            self.report({"ERROR"}, str(error))
        else:
            self.report({"INFO"}, "Stopped. The frames so far are kept; Resume goes on.")
        finally:
            self._finish(context)

    def _begin(
        self, context: bpy.types.Context
    ) -> Generator[BakeProgress, bool | None, BakeResult]:
        if running is not None:
            raise BakeError("A bake is running already. Press Esc to stop it.")
        return bake_steps(context, resume=self._resume)

    def _advance(self, context: bpy.types.Context) -> bool:
        """Do one frame; False when the bake is over, whichever way."""
        global running
        assert self._steps is not None
        try:
            running = next(self._steps)
        except StopIteration as finished:
            self._finish(context)
            self._report_result(finished.value)
            return False
        except (BakeError, CacheError) as error:
            self._finish(context)
            self.report({"ERROR"}, str(error))
            return False
        except BaseException:
            self._finish(context)
            raise
        playback.refresh(context.scene, during_bake=True)
        context.window_manager.progress_update(100 * running.done // running.total)
        context.workspace.status_text_set(
            f"Baking clay: frame {running.frame}, {running.done} of {running.total}, "
            f"{duration_text(running.seconds_left)} left   Esc: stop"
        )
        redraw_views()
        return True

    def _finish(self, context: bpy.types.Context) -> None:
        global running
        running = None
        self._steps = None
        manager = context.window_manager
        if self._timer is not None:
            manager.event_timer_remove(self._timer)
            self._timer = None
        manager.progress_end()
        if context.workspace:
            context.workspace.status_text_set(None)
        playback.refresh(context.scene)
        redraw_views()

    def _report_result(self, result: BakeResult) -> set[str]:
        for warning in result.warnings:
            self.report({"WARNING"}, warning)
        self.report(
            {"INFO"},
            f"{result.baked} frames baked, {result.kept} kept, in {duration_text(result.seconds)}",
        )
        return {"FINISHED"}


class CLAY_OT_bake(_BakeOperator, bpy.types.Operator):  # noqa: N801
    """Simulate the clay over the frame range, starting over; Esc stops and keeps what is done"""

    bl_idname = "clay.bake"
    bl_label = "Bake"
    bl_options = {"REGISTER"}


class CLAY_OT_resume(_BakeOperator, bpy.types.Operator):  # noqa: N801
    """Go on with a bake at its first missing frame; the result is the same as without a break"""

    bl_idname = "clay.resume"
    bl_label = "Resume"
    bl_options = {"REGISTER"}
    _resume = True


class CLAY_OT_free(bpy.types.Operator):  # noqa: N801
    """Remove the bake from the disk and show the clay as it was made"""

    bl_idname = "clay.free"
    bl_label = "Free"
    bl_options = {"REGISTER", "UNDO"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first: files cannot be brought back by Undo."""
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the bake."""
        if running is not None:
            self.report({"ERROR"}, "A bake is running. Press Esc to stop it first.")
            return {"CANCELLED"}
        try:
            size = free(context.scene)
        except (BakeError, CacheError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{size_text(size)} freed")
        return {"FINISHED"}


_CLASSES = (CLAY_OT_bake, CLAY_OT_resume, CLAY_OT_free)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators; Blender ends a bake that runs."""
    global running
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    running = None
