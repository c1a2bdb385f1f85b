# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain meshes and materials, from which the objects of the ready-made scenes are built."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

Vec3 = tuple[float, float, float]


def mesh_object(name: str, vertices: NDArray, faces: Sequence | NDArray) -> bpy.types.Object:
    """Add an object with vertices, shape [V, 3], and faces to the active collection."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices).tolist(), [], [list(face) for face in faces])
    mesh.update()
    item = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(item)
    return item


def plain_material(name: str, color: Vec3, roughness: float) -> bpy.types.Material:
    """Create a material of one color, linear RGB."""
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    material.diffuse_color = (*color, 1.0)
    return material
