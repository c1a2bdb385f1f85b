# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake to USD or Alembic as an operator, with progress and Esc in the interface."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import bpy

from ..bake import operators as bake_operators
from ..bake.operators import duration_text, size_text
from ..model.clay_scene import clay_objects
from .delivery import DeliveryError, DeliveryProgress, DeliveryResult, deliver_steps
from .object import delivered_object, remove_delivery

running: DeliveryProgress | None = None
"""How far the delivery in the interface is; None while there is none."""


def describe(result: DeliveryResult) -> str:
    """What a delivery did, in a sentence or two."""
    shapes = f"{result.shapes} shapes" if result.shapes != 1 else "1 shape"
    return (
        f"Frames {result.start} to {result.end}, {shapes}: {size_text(result.bytes)}, "
        f"{size_text(result.bytes_per_shape)} and {result.seconds_per_shape:.2g} s each, "
        f"{duration_text(result.seconds)} in all"
    )


class _DeliverOperator:
    """Delivering, with or without a window."""

    report: Any
    _steps: Generator[DeliveryProgress, None, DeliveryResult] | None = None
    _timer: bpy.types.Timer | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where there is clay."""
        return bool(clay_objects(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Deliver without an interface: to the end, or to an error."""
        steps = self._begin(context)
        try:
            while True:
                next(steps)
        except StopIteration as finished:
            return self._report_result(finished.value)
        except DeliveryError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Deliver in the interface, a frame at a time."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        if running is not None or bake_operators.running is not None:
            self.report({"ERROR"}, "A bake is running already. Press Esc to stop it.")
            return {"CANCELLED"}
        self._steps = self._begin(context)
        # The first step checks everything; an error in it ends the operator at once.
        done = self._advance(context)
        if done is not None:
            return done
        manager = context.window_manager
        manager.progress_begin(0, 100)
        self._timer = manager.event_timer_add(0.01, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Write one frame at each tick; Esc stops."""
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, "Stopped. Nothing was changed.")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        return self._advance(context) or {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop when Blender ends the operator."""
        if self._steps is not None:
            self._steps.close()
        self._finish(context)

    def _begin(
        self, context: bpy.types.Context
    ) -> Generator[DeliveryProgress, None, DeliveryResult]:
        properties = context.scene.tactile_clay
        return deliver_steps(
            context, kind=properties.delivery_kind, points=properties.delivery_points
        )

    def _advance(self, context: bpy.types.Context) -> set[str] | None:
        """Write a frame; gives how the operator ends, None while it goes on."""
        global running
        assert self._steps is not None
        try:
            running = next(self._steps)
        except StopIteration as finished:
            self._finish(context)
            return self._report_result(finished.value)
        except DeliveryError as error:
            self._finish(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except BaseException:
            self._finish(context)
            raise
        context.window_manager.progress_update(100 * running.done // running.total)
        context.workspace.status_text_set(
            f"Writing clay: frame {running.frame}, {running.done} of {running.total}, "
            f"{size_text(running.bytes)}, {duration_text(running.seconds_left)} left   Esc: stop"
        )
        return None

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

    def _report_result(self, result: DeliveryResult) -> set[str]:
        self.report({"INFO"}, f"{describe(result)}. Save the .blend to keep it.")
        return {"FINISHED"}


class CLAY_OT_deliver(_DeliverOperator, bpy.types.Operator):  # noqa: N801
    """Write the clay's surface over time and play that in place of the clay: the .blend and its
    folder then play and render anywhere. Esc stops and changes nothing"""

    bl_idname = "clay.deliver"
    bl_label = "Bake to USD"
    bl_options = {"REGISTER", "UNDO"}


class CLAY_OT_deliver_remove(bpy.types.Operator):  # noqa: N801
    """Show the clay again in place of what was delivered; its files stay on the disk"""

    bl_idname = "clay.deliver_remove"
    bl_label = "Show Clay Again"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where something is delivered."""
        return delivered_object(context.scene) is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the object that plays the files."""
        remove_delivery(context.scene)
        return {"FINISHED"}


_CLASSES = (CLAY_OT_deliver, CLAY_OT_deliver_remove)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators; Blender ends a delivery that runs."""
    global running
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    running = None
