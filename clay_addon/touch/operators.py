# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators to connect and disconnect the array, and to make a picture of its sound."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..base.units import from_meters
from .array import TouchArrayError, placed_array
from .connection import TouchError, touch

_PICTURE = "Touch Field"
_EDGE = 0.16
"""Edge length of the picture [m]."""
_PIXELS = 128


class CLAY_OT_touch_connect(bpy.types.Operator):  # noqa: N801
    """Connect the ultrasound array, which is silent until a hand touches clay"""

    bl_idname = "clay.touch_connect"
    bl_label = "Connect"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Connect, or report why not."""
        try:
            touch.connect(context)
        except (TouchError, TouchArrayError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class CLAY_OT_touch_disconnect(bpy.types.Operator):  # noqa: N801
    """Silence and disconnect the ultrasound array"""

    bl_idname = "clay.touch_disconnect"
    bl_label = "Disconnect"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while connected."""
        return touch.client is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Disconnect."""
        touch.disconnect()
        return {"FINISHED"}


def field_picture(scene: bpy.types.Scene) -> bpy.types.Object:
    """Make an image empty of the simulated sound in the plane of the touched skin.

    Args:
        scene: Holds the array; the image shows the current frame.

    Raises:
        TouchError: There is no array, or the frame has no focal points.
        TouchArrayError: The array object is scaled or sheared.
    """
    from ...haptics import solve_drive
    from ...haptics.acoustics.field_picture import field_on_plane, palm_plane, pressure_colors

    array, frame = placed_array(scene), touch.shown
    if array is None:
        raise TouchError("There is no array in this scene. Add one in the Touch panel.")
    if frame is None or frame.foci.count == 0:
        raise TouchError("There are no focal points at this frame, so there is no sound to show.")
    points, pressures = frame.foci.positions, frame.foci.pressures
    drive = solve_drive(array, points, pressures)
    if frame.skin is not None and frame.wanted is not None and len(frame.skin):
        points, pressures = frame.skin, frame.wanted
    middle, axes = palm_plane(points, pressures, array.normal)
    values = field_on_plane(array, drive, middle, axes, size=_EDGE, count=_PIXELS)
    image = bpy.data.images.get(_PICTURE) or bpy.data.images.new(_PICTURE, _PIXELS, _PIXELS)
    image.pixels.foreach_set(pressure_colors(values, float(values.max())).ravel())
    image.update()
    image["largest_pressure"] = float(values.max())
    item = bpy.data.objects.get(_PICTURE) or bpy.data.objects.new(_PICTURE, None)
    item.empty_display_type = "IMAGE"
    item.data = image
    item.empty_display_size = from_meters(scene, _EDGE)
    item.hide_render = True
    matrix = np.eye(4)
    matrix[:3, :3] = axes
    matrix[:3, 3] = from_meters(scene, middle)
    item.matrix_world = Matrix(matrix.tolist())
    if item.name not in scene.objects:
        scene.collection.objects.link(item)
    return item


class CLAY_OT_touch_picture(bpy.types.Operator):  # noqa: N801
    """Show the simulated sound in the plane of the touched skin as an image"""

    bl_idname = "clay.touch_picture"
    bl_label = "Picture of the Field"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make the image, or report why not."""
        try:
            item = field_picture(context.scene)
        except (TouchError, TouchArrayError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        largest = item.data["largest_pressure"]
        self.report({"INFO"}, f"{_PICTURE}: up to {largest:.0f} Pa.")
        return {"FINISHED"}


_CLASSES = (CLAY_OT_touch_connect, CLAY_OT_touch_disconnect, CLAY_OT_touch_picture)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
