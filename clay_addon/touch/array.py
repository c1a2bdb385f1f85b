# SPDX-License-Identifier: GPL-3.0-or-later
"""The ultrasound array as an object in the scene, which gives its position and rotation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np

from ...solver.core.errors import TactileClayError
from ..base.units import from_meters, pose_to_meters
from .properties import ARRAY_ITEMS

if TYPE_CHECKING:
    from ...haptics import TransducerArray

_CORNERS = 12
_MARGIN = 0.012
"""Distance from the centers of the outermost transducers to the edge of the plate [m]."""
_ARROW = 0.06
"""Length of the arrow that shows the direction of the sound [m]."""


class TouchArrayError(TactileClayError):
    """An array object cannot be used; the message says why and what to do."""


def add_array(context: bpy.types.Context, preset: str) -> bpy.types.Object:
    """Add an array object at the 3D cursor, facing its Z axis, and make it the scene's array.

    Args:
        context: Gives the scene and collection to add the object to.
        preset: Name of the array preset.
    """
    from ...haptics import TransducerArray

    scene = context.scene
    array = TransducerArray.preset(preset)
    label = next(item[1] for item in ARRAY_ITEMS if item[0] == preset)
    item = bpy.data.objects.new(label, _mesh(label, array, scene))
    item.tactile_touch.is_array = True
    item.tactile_touch.preset = preset
    item.hide_render = True
    item.location = scene.cursor.location
    item.rotation_euler = scene.cursor.rotation_euler
    context.collection.objects.link(item)
    scene.tactile_touch.array = item
    return item


def _mesh(name: str, array: TransducerArray, scene: bpy.types.Scene) -> bpy.types.Mesh:
    """An outline of the plate, a disc for each transducer, and an arrow along the sound."""
    angle = 2.0 * np.pi * np.arange(_CORNERS) / _CORNERS
    disc = array.radius * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(_CORNERS)))
    discs = (array.positions[:, None] + disc).reshape(-1, 3)
    low = array.positions.min(axis=0) - _MARGIN
    high = array.positions.max(axis=0) + _MARGIN
    plate = [(low[0], low[1], 0), (high[0], low[1], 0), (high[0], high[1], 0), (low[0], high[1], 0)]
    tip, side = _ARROW, 0.15 * _ARROW
    arrow = [(0, 0, 0), (0, 0, tip), (side, 0, tip - side), (-side, 0, tip - side)]
    first = len(discs)
    vertices = from_meters(scene, np.concatenate((discs, plate, arrow)))
    edges = [(first + i, first + (i + 1) % 4) for i in range(4)]
    edges += [(first + 4 + a, first + 4 + b) for a, b in ((0, 1), (1, 2), (1, 3))]
    faces = np.arange(first).reshape(-1, _CORNERS).tolist()
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), edges, faces)
    return mesh


def placed_array(scene: bpy.types.Scene) -> TransducerArray | None:
    """The scene's array at the pose of its object, in meters; None if the scene has no array.

    Raises:
        TouchArrayError: The object is scaled or sheared.
    """
    item = scene.tactile_touch.array
    if item is None or item.name not in scene.objects:
        return None
    from ...haptics import TransducerArray

    matrix = pose_to_meters(scene, item.matrix_world)
    try:
        return TransducerArray.preset(item.tactile_touch.preset).placed(matrix)
    except ValueError as error:
        raise TouchArrayError(
            f"{item.name!r} is scaled or sheared, but an array can only be moved and rotated. "
            "Clear the scale (Alt+S)."
        ) from error


class CLAY_OT_array_add(bpy.types.Operator):  # noqa: N801
    """Add an ultrasound array object, to place where the real array is"""

    bl_idname = "clay.array_add"
    bl_label = "Add Array"
    bl_options = {"REGISTER", "UNDO"}

    preset: bpy.props.EnumProperty(name="Array", items=ARRAY_ITEMS, default="sonicsurface")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """In Object Mode only."""
        return bool(context.mode == "OBJECT")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the array, and select it."""
        item = add_array(context, self.preset)
        for other in context.selected_objects:
            other.select_set(False)
        item.select_set(True)
        context.view_layer.objects.active = item
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(CLAY_OT_array_add)


def unregister() -> None:
    """Unregister the operator."""
    bpy.utils.unregister_class(CLAY_OT_array_add)
