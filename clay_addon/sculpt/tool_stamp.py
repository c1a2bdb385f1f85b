# SPDX-License-Identifier: GPL-3.0-or-later
"""Custom stamps: any closed mesh object as a sculpting tool."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ...solver.geometry.closed_mesh import MeshError, check_closed_mesh
from ..base.mesh_geometry import (
    SWITCHED_OFF,
    evaluated_mesh,
    is_switched_off,
    oriented_triangles,
    transform,
)
from ..core.tools.presets import ToolPreset, ToolPresetError, load_tool_preset


def stamp_from_object(item: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> ToolPreset:
    """A stamp with the shape of a mesh object, with modifiers and scale applied.

    The side that faces the object's local -Z leaves the imprint. The mesh is centered in x and y
    with its lowest point at height 0, and scaled to fit a circle of radius 1 seen along Z.

    Args:
        item: A closed mesh object; it is not changed.
        depsgraph: The evaluated scene.

    Raises:
        ToolPresetError: The object cannot be a stamp; the message names it and says why.
    """
    if item.type != "MESH":
        raise ToolPresetError(
            f"{item.name!r} is not a mesh ({item.type.lower()}), so it cannot be a stamp. Choose a "
            "closed mesh, or convert it to one (Object > Convert > Mesh)."
        )
    if is_switched_off(item, depsgraph):
        raise ToolPresetError(f"{item.name!r} {SWITCHED_OFF}")
    vertices, triangles = evaluated_mesh(item, depsgraph)
    scale = item.evaluated_get(depsgraph).matrix_world.to_scale()
    matrix = np.diag((*scale, 1.0))
    try:
        vertices, triangles = check_closed_mesh(
            transform(matrix, vertices), oriented_triangles(matrix, triangles), name=repr(item.name)
        )
    except MeshError as error:
        raise ToolPresetError(str(error)) from error
    low, high = vertices.min(0), vertices.max(0)
    vertices -= (*(0.5 * (low + high))[:2], low[2])
    vertices /= np.hypot(vertices[:, 0], vertices[:, 1]).max()
    return replace(
        load_tool_preset("stamp"),
        name=item.name,
        label=item.name,
        description=f"Imprints the shape of {item.name}",
        vertices=vertices,
        faces=triangles,
    )
