# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake to USD or Alembic as an operator, with progress and Esc in the interface."""

from __future__ import annotations

from collections.abc import Generator

import bpy

from ..base.modal import SteppedOperator
from ..core.readable import duration_text, size_text
from ..model.clay_scene import clay_objects
from .delivery import DeliveryProgress, DeliveryResult, deliver_steps
from .object import delivered_object, remove_delivery


def delivery_text(result: DeliveryResult) -> str:
    """What a delivery did, in a sentence or two."""
    shapes = f"{result.shapes} shapes" if result.shapes != 1 else "1 shape"
    return (
        f"Frames {result.start} to {result.end}, {shapes}: {size_text(result.bytes)}, "
        f"{size_text(result.bytes_per_shape)} and {result.seconds_per_shape:.2g} s each, "
        f"{duration_text(result.seconds)} in all"
    )


class CLAY_OT_deliver(  # noqa: N801
    SteppedOperator[DeliveryProgress, DeliveryResult], bpy.types.Operator
):
    """Write the clay's surface over time and play that in place of the clay: the .blend and its
    folder then play and render anywhere. Esc stops and changes nothing"""

    bl_idname = "clay.deliver"
    bl_label = "Bake to USD"
    bl_options = {"REGISTER", "UNDO"}
    stopped_text = "Stopped. Nothing was changed."

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only where there is clay."""
        return bool(clay_objects(context.scene))

    def begin(
        self, context: bpy.types.Context
    ) -> Generator[DeliveryProgress, None, DeliveryResult]:
        """Deliver as the scene's properties say."""
        properties = context.scene.tactile_clay
        return deliver_steps(
            context, kind=properties.delivery_kind, points=properties.delivery_points
        )

    def status(self, step: DeliveryProgress) -> str:
        """Frame, size and time left."""
        return (
            f"Writing clay: frame {step.frame}, {step.done} of {step.total}, "
            f"{size_text(step.bytes)}, {duration_text(step.seconds_left)} left   Esc: stop"
        )

    def report_result(self, result: DeliveryResult) -> None:
        """Say what was written."""
        self.report({"INFO"}, f"{delivery_text(result)}. Save the .blend to keep it.")


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
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
