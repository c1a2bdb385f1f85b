# SPDX-License-Identifier: GPL-3.0-or-later
"""The Sculpt operator, which runs the live session, and operators that end or revert it."""

from __future__ import annotations

from typing import Any

import bpy
from bpy.app.handlers import persistent

from ..base.app_handlers import add_handlers, redraw_views, remove_handlers
from ..clay.look import show_colors
from ..core.brush.brush import Brush
from ..model.clay_points import keep_sculpted, replace_points
from .live.checks import SculptError
from .live.current import current
from .live.session import SculptSession
from .overlay import overlay
from .properties import SceneSource

_TICK_SECONDS = 1.0 / 120.0
"""Timer interval [s]: half a step, so that the solver hardly waits for the next tick."""
_SPEED_KEYS = {"PAGE_UP": 10.0, "PAGE_DOWN": -10.0}
"""Keys that change the speed of a potter's wheel, and by how much [rpm]."""
_COMPILING_AFTER = 0.5
"""If the solver takes longer than this to start [s], kernels are being compiled."""


class CLAY_OT_sculpt(bpy.types.Operator):  # noqa: N801
    """Sculpt the clay live, with tracked hands and the mouse; Esc ends and keeps the result"""

    bl_idname = "clay.sculpt"
    bl_label = "Sculpt"
    bl_options = {"REGISTER"}

    _timer: bpy.types.Timer | None = None
    _session: SculptSession | None = None
    _brush: Brush | None = None
    _shown_status = ""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available while no session is running."""
        return current.session is None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Refuse to run without a window, as a session is interactive."""
        self.report({"ERROR"}, "Sculpt needs a window. To simulate without one, use Bake.")
        return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start a session."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            self._brush = Brush(SceneSource(context.scene))
            self._session = current.start(context, self._brush)
            overlay.show(self._brush)
        except SculptError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        show_colors()
        manager = context.window_manager
        self._timer = manager.event_timer_add(_TICK_SECONDS, window=context.window)
        manager.modal_handler_add(self)
        self._update_status(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Handle the timer, the mouse and keys."""
        running, brush = self._session, self._brush
        # Finish, another file or disabling the extension may have ended the session.
        if running is None or brush is None or current.session is not running:
            return self._end(context)
        try:
            if event.type == "TIMER":
                news = running.tick(context)
                self._update_status(context)
                if news:
                    redraw_views()
                return {"PASS_THROUGH"}
            if brush.handle(context, event):
                redraw_views()
                return {"RUNNING_MODAL"}
            if opens_tool_menu(event, brush):
                bpy.ops.wm.call_menu(name="CLAY_MT_sculpt_tools")
                return {"RUNNING_MODAL"}
            if event.type in _SPEED_KEYS and event.value == "PRESS" and running.wheels:
                running.wheels.change_speeds(context.scene, _SPEED_KEYS[event.type])
                return {"RUNNING_MODAL"}
            if event.type == "ESC" and event.value == "PRESS":
                return self._end(context)
        except SculptError as error:
            self.report({"ERROR"}, f"Sculpting has ended. {error}")
            return self._end(context)
        except BaseException:
            # Never leave a session running without its operator.
            self._end(context)
            raise
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """End the session when Blender cancels the operator, as when it closes the window."""
        self._end(context)

    def _update_status(self, context: bpy.types.Context) -> None:
        """Update the status bar if its text has changed."""
        assert self._session is not None and self._brush is not None
        text = status_text(self._session, self._brush)
        if text != self._shown_status and context.workspace:
            context.workspace.status_text_set(text)
            self._shown_status = text

    def _end(self, context: bpy.types.Context) -> set[str]:
        running, self._session = self._session, None
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if self._brush is not None:
            overlay.hide()
            self._brush.cancel()
            self._brush = None
        if running is not None:
            if current.session is running:
                current.stop(context)
            for message in running.messages:
                self.report({"INFO"}, message)
        if context.workspace:
            context.workspace.status_text_set(None)
        redraw_views()
        return {"FINISHED"}


class CLAY_OT_sculpt_finish(bpy.types.Operator):  # noqa: N801
    """End sculpting and keep the clay"""

    bl_idname = "clay.sculpt_finish"
    bl_label = "Finish"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available while a session is running."""
        return current.session is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """End the session; its operator notices at its next event."""
        current.stop(context)
        return {"FINISHED"}


class CLAY_OT_sculpt_revert(bpy.types.Operator):  # noqa: N801
    """Revert everything done in the last session, in one undo step"""

    bl_idname = "clay.sculpt_revert"
    bl_label = "Revert Session"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available if no session is running and the clay before the last one is known."""
        return current.session is None and bool(current.clay_before)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Restore the points that each clay object had before the session."""
        found = 0
        for name, (local, colors) in current.clay_before.items():
            item = context.scene.objects.get(name)
            if item is None or item.type != "POINTCLOUD" or item.tactile_clay.role != "CLAY":
                continue
            replace_points(context, item, local, colors)
            keep_sculpted(item)
            found += 1
        if not found:
            self.report({"ERROR"}, "The clay of that session is no longer in this scene.")
            return {"CANCELLED"}
        return {"FINISHED"}


def opens_tool_menu(event: Any, brush: Brush) -> bool:
    """Whether an event opens the tool menu: Shift Space, as for Blender's own toolbar pop-up."""
    return bool(
        event.type == "SPACE"
        and event.shift
        and event.value == "PRESS"
        and brush.pointer is not None
    )


def status_text(running: SculptSession, brush: Brush) -> str:
    """What the session is doing, as text for the status bar."""
    seconds = running.compiling_seconds
    if seconds > _COMPILING_AFTER:
        return (
            f"Compiling the clay's kernels: {seconds:.0f} s. This happens once after installation "
            "and takes about a minute   Esc: stop"
        )
    factor = round(10.0 * running.factor)
    pace = "" if factor >= 10 else f" at {10 * factor} % of real time"
    keys = "   Page Up, Page Down: wheel faster, slower" if running.wheels else ""
    return f"Sculpting{pace}   {brush.status_text()}{keys}"


@persistent
def _on_load_pre(*_: object) -> None:
    # Sculpting since the file was saved is lost like all unsaved changes.
    current.stop(None)


@persistent
def _on_undo(*_: object) -> None:
    if current.session is not None:
        current.session.undone()


@persistent
def _on_save_pre(*_: object) -> None:
    if current.session is not None:
        current.session.before_saving(bpy.context.scene)


@persistent
def _on_save_post(*_: object) -> None:
    if current.session is not None:
        current.session.autosave.forget()


_HANDLERS = (
    ("load_pre", _on_load_pre),
    ("undo_post", _on_undo),
    ("redo_post", _on_undo),
    ("save_pre", _on_save_pre),
    ("save_post", _on_save_post),
)
_CLASSES = (CLAY_OT_sculpt, CLAY_OT_sculpt_finish, CLAY_OT_sculpt_revert)


def register() -> None:
    """Register the operators and the handlers."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    add_handlers(_HANDLERS)


def unregister() -> None:
    """End a running session and unregister everything."""
    current.stop(bpy.context)
    remove_handlers(_HANDLERS)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
