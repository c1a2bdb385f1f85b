# SPDX-License-Identifier: GPL-3.0-or-later
"""Point clouds as clay has them: made at any size, with the attributes of particles."""

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
    """A point cloud object in the active collection, with the attributes that clay has.

    Args:
        context: Where to make it.
        points: Positions [Blender units], shape [N, 3].
        colors: Linear RGBA, shape [N, 4].
        spacing: Distance between particles [Blender units].
        name: Of the object and its points.
    """
    count = len(points)
    data = bpy.data.pointclouds.new(name)
    # The class does not have what its objects have.
    if hasattr(data, "resize"):
        data.resize(count)
        write_attributes(data, points, colors, spacing)
        item = bpy.data.objects.new(name, data)
        context.collection.objects.link(item)
        return item
    bpy.data.pointclouds.remove(data)
    # Blender 4.5 can size a point cloud in no other way than to convert a mesh.
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
    """Write the attributes that clay has into a point cloud, or a mesh, of N points.

    Args:
        data: What to write into.
        points: Positions [Blender units], shape [N, 3].
        colors: Linear RGBA, shape [N, 4].
        spacing: Distance between particles [Blender units].
    """
    # The name matters: Cycles shows an attribute named "color" black.
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
