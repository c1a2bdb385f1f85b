# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing a clay object's points: positions, colors, number and starting shape.

The next bake or session starts from the shape that was last sculpted, which the attribute
``rest_position`` holds.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from .point_cloud import make_point_cloud, write_attributes

BAKED_MARK = "clay_baked"
"""Custom property of a point cloud that shows a baked frame. It is stored on the data, not the
object, so that Undo restores both or neither."""
SCULPTED_MARK = "clay_sculpted"
"""Custom property of a point cloud whose starting shape was sculpted since it was baked; a bake
removes it."""
ABSENT = "clay_absent"
"""Attribute of a point cloud some of whose points are absent at times. Absent points coincide
exactly with another point; the attribute is true for those absent at the start."""


def present_rows(item: bpy.types.Object, local: NDArray[np.floating]) -> slice | NDArray[np.int64]:
    """Indices of the points that are present, as a slice or an array of shape [P].

    Args:
        item: A clay object.
        local: Positions of all its points, shape [N, 3].
    """
    if ABSENT not in item.data.attributes:
        return slice(None)
    return np.sort(np.unique(local, axis=0, return_index=True)[1])


def write_points(
    item: bpy.types.Object, local: NDArray[np.floating], attribute: str = "position"
) -> None:
    """Write where a clay object's points are; where they are there already, nothing is evaluated.

    Args:
        item: A clay object.
        local: Positions in its coordinates [Blender units], shape [N, 3].
        attribute: An existing vector attribute of the points.
    """
    values = np.ascontiguousarray(local, np.float32).ravel()
    layer = item.data.attributes[attribute].data
    shown = np.empty_like(values)
    if len(layer) * 3 == len(values):
        layer.foreach_get("vector", shown)
        # The surface of a piece at rest costs as much as that of one that moves.
        if np.array_equal(shown, values):
            return
    layer.foreach_set("vector", values)
    item.data.update_tag()


def write_colors(item: bpy.types.Object, colors: NDArray[np.floating]) -> None:
    """Write the colors of a clay object's points, linear RGBA, shape [N, 4]."""
    values = np.ascontiguousarray(colors, np.float32).ravel()
    item.data.attributes["Color"].data.foreach_set("color", values)
    item.data.update_tag()


def replace_points(
    context: bpy.types.Context,
    item: bpy.types.Object,
    local: NDArray[np.floating],
    colors: NDArray[np.floating],
) -> None:
    """Replace a clay object's points, whose number may change.

    Args:
        context: The context whose view layer contains the object.
        item: A clay object.
        local: Positions in its coordinates [Blender units], shape [N, 3], with N at least 1.
        colors: Linear RGBA, shape [N, 4].

    Raises:
        ValueError: There are no points.
    """
    if not len(local):
        raise ValueError(f"{item.name!r} would have no clay left.")
    points = np.ascontiguousarray(local, np.float32)
    tints = np.ascontiguousarray(colors, np.float32)
    spacing = item.tactile_clay.spacing
    # Only instances have the attribute, so the class cannot be asked.
    if hasattr(item.data, "resize"):
        item.data.resize(len(points))
        write_attributes(item.data, points, tints, spacing)
        return
    # Blender 4.5 cannot resize a point cloud, so the object gets a new one.
    active, selected = context.view_layer.objects.active, list(context.selected_objects)
    carrier = make_point_cloud(context, points, tints, spacing, item.data.name)
    before, item.data = item.data, carrier.data
    bpy.data.objects.remove(carrier)
    for material in before.materials:
        item.data.materials.append(material)
    for key, value in before.items():
        item.data[key] = value
    if not before.users:
        name = before.name
        bpy.data.pointclouds.remove(before)
        item.data.name = name
    for other in context.view_layer.objects:
        other.select_set(other in selected)
    context.view_layer.objects.active = active


def keep_sculpted(item: bpy.types.Object) -> None:
    """Make the displayed shape the one that the next bake or session starts from."""
    values = np.empty(3 * len(item.data.points), np.float32)
    item.data.attributes["position"].data.foreach_get("vector", values)
    write_points(item, values, "rest_position")
    item.data.pop(BAKED_MARK, None)
    item.data[SCULPTED_MARK] = True


def is_sculpted(item: bpy.types.Object) -> bool:
    """Whether a clay object was sculpted since it was baked."""
    return SCULPTED_MARK in item.data
