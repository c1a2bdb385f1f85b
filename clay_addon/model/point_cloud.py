# SPDX-License-Identifier: GPL-3.0-or-later
"""Creating point clouds of any size with the attributes of clay particles."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray


def make_point_cloud(
    context: bpy.types.Context,
    points: NDArray[np.float32],
    colors: NDArray[np.float32],
    spacing: float,
    name: str,
) -> bpy.types.Object:
    """Create a point cloud object in the active collection, with the attributes of clay.

    Args:
        context: The context that has the collection.
        points: Positions [Blender units], shape [N, 3].
        colors: Linear RGBA, shape [N, 4].
        spacing: Distance between particles [Blender units].
        name: Name of the object and its data.
    """
    count = len(points)
    data = bpy.data.pointclouds.new(name)
    # Only instances have the attribute, so the class cannot be asked.
    if hasattr(data, "resize"):
        data.resize(count)
        write_attributes(data, points, colors, spacing)
        item = bpy.data.objects.new(name, data)
        context.collection.objects.link(item)
        return item
    bpy.data.pointclouds.remove(data)
    # In Blender 4.5, converting a mesh is the only way to get a point cloud of a given size.
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(count)
    write_attributes(mesh, points, colors, spacing)
    item = bpy.data.objects.new(name, mesh)
    collection = context.collection
    context.scene.collection.objects.link(item)
    item.select_set(True)
    context.view_layer.objects.active = item
    with context.temp_override(
        active_object=item, object=item, selected_objects=[item], selected_editable_objects=[item]
    ):
        bpy.ops.object.convert(target="POINTCLOUD")
    item.data.name = name
    bpy.data.meshes.remove(mesh)
    if collection != context.scene.collection:
        collection.objects.link(item)
        context.scene.collection.objects.unlink(item)
    return item


def write_attributes(
    data: bpy.types.ID, points: NDArray[np.float32], colors: NDArray[np.float32], spacing: float
) -> None:
    """Write the attributes of clay to a point cloud, or a mesh, of N points.

    Args:
        data: The point cloud or mesh.
        points: Positions [Blender units], shape [N, 3].
        colors: Linear RGBA, shape [N, 4].
        spacing: Distance between particles [Blender units].
    """
    # Not "color": Cycles reads an attribute of that name as black.
    radius = np.full(len(points), 0.5 * spacing, np.float32)
    for attribute, kind, key, values in (
        ("position", "FLOAT_VECTOR", "vector", points),
        ("radius", "FLOAT", "value", radius),
        ("Color", "FLOAT_COLOR", "color", colors),
        ("rest_position", "FLOAT_VECTOR", "vector", points),
    ):
        layer = data.attributes.get(attribute) or data.attributes.new(attribute, kind, "POINT")
        layer.data.foreach_set(key, np.ascontiguousarray(values, np.float32).ravel())
    data.update_tag()
