# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators to bake to USD or Alembic, with progress in the interface and Esc to stop."""

from __future__ import annotations

from collections.abc import Generator

import bpy

from ..base.modal import SteppedOperator
from ..core.readable import duration_text, size_text
from ..model.clay_scene import clay_objects
from .delivery import DeliveryProgress, DeliveryResult, deliver_steps
from .object import delivered_object, remove_delivery


def delivery_text(result: DeliveryResult) -> str:
    """Summary of a delivery for the user."""
    shapes = f"{result.shapes} shapes" if result.shapes != 1 else "1 shape"
    return (
        f"Frames {result.start} to {result.end}, {shapes}: {size_text(result.bytes)}, "
        f"{size_text(result.bytes_per_shape)} and {result.seconds_per_shape:.2g} s each, "
        f"{duration_text(result.seconds)} in all"
    )


class CLAY_OT_deliver(  # noqa: N801
    SteppedOperator[DeliveryProgress, DeliveryResult], bpy.types.Operator
):
    """Write the clay's surface over time and play it in place of the clay: the .blend and its
    folder then play and render anywhere. Esc stops and changes nothing"""

    bl_idname = "clay.deliver"
    bl_label = "Bake to USD"
    bl_options = {"REGISTER", "UNDO"}
    stopped_text = "Stopped. Nothing was changed."

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require clay in the scene."""
        return bool(clay_objects(context.scene))

    def begin(
        self, context: bpy.types.Context
    ) -> Generator[DeliveryProgress, None, DeliveryResult]:
        """Deliver with the scene's settings."""
        properties = context.scene.tactile_clay
        return deliver_steps(
            context, kind=properties.delivery_kind, points=properties.delivery_points
        )

    def status(self, step: DeliveryProgress) -> str:
        """Current frame, size and remaining time."""
        return (
            f"Writing clay: frame {step.frame}, {step.done} of {step.total}, "
            f"{size_text(step.bytes)}, {duration_text(step.seconds_left)} left   Esc: stop"
        )

    def report_result(self, result: DeliveryResult) -> None:
        """Report a summary of the delivery."""
        self.report({"INFO"}, f"{delivery_text(result)}. Save the .blend to keep it.")


class CLAY_OT_deliver_remove(bpy.types.Operator):  # noqa: N801
    """Show the clay again in place of the delivered files, which remain on disk"""

    bl_idname = "clay.deliver_remove"
    bl_label = "Show Clay Again"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require a delivery in the scene."""
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
    """Unregister the operators; Blender ends a running delivery."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
