# SPDX-License-Identifier: GPL-3.0-or-later
"""Connect, Disconnect, and a picture of the sound, as operators."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..base.units import from_meters
from .array import TouchArrayError, placed_array
from .connection import TouchError, touch

_PICTURE = "Touch Field"
_EDGE = 0.16
"""Edge of the picture [m]."""
_PIXELS = 128


class CLAY_OT_touch_connect(bpy.types.Operator):  # noqa: N801
    """Start driving the ultrasound array; it is silent until clay is touched"""

    bl_idname = "clay.touch_connect"
    bl_label = "Connect"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start the server."""
        try:
            touch.connect(context)
        except (TouchError, TouchArrayError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class CLAY_OT_touch_disconnect(bpy.types.Operator):  # noqa: N801
    """Silence the ultrasound array and let go of it"""

    bl_idname = "clay.touch_disconnect"
    bl_label = "Disconnect"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while connected."""
        return touch.client is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """End the server."""
        touch.disconnect()
        return {"FINISHED"}


def field_picture(scene: bpy.types.Scene) -> bpy.types.Object:
    """Paint the simulated sound in the plane of the touched skin, as an image where it is.

    Args:
        scene: Its array, and the frame that is shown, count.

    Raises:
        TouchError: There is no array, or nothing is felt.
        TouchArrayError: The array object is scaled.
    """
    from ...haptics import solve_drive
    from ...haptics.acoustics.field_picture import field_on_plane, palm_plane, pressure_colors

    array, frame = placed_array(scene), touch.shown
    if array is None:
        raise TouchError("There is no array in this scene: Add > Ultrasound Array.")
    if frame is None or frame.foci.count == 0:
        raise TouchError("Nothing is felt at this frame, so there is no sound to paint.")
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
    """Paint the simulated sound in the plane of the touched skin"""

    bl_idname = "clay.touch_picture"
    bl_label = "Picture of the Field"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Paint it."""
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
