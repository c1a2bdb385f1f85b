# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing the clay's surface into a Blender mesh, fast enough for every redraw."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

COLOR_ATTRIBUTE = "Color"
"""Not "color": Cycles reads an attribute of that name as black."""
TEXTURE_ATTRIBUTE = "clay_texture"
"""Positions in units of the particle spacing, so that the clay's grain scales with its detail."""
SPACING_ATTRIBUTE = "clay_spacing"
"""The particle spacing [Blender units], which sets the depth of the grain."""


def fill_surface_mesh(
    mesh: bpy.types.Mesh,
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    *,
    spacing: float,
    colors: NDArray[np.floating] | None = None,
    edges: NDArray[np.integer] | None = None,
    face_edges: NDArray[np.integer] | None = None,
) -> None:
    """Replace the geometry of a mesh with a smooth-shaded surface; its materials stay.

    Args:
        mesh: The mesh.
        vertices: Vertex positions [Blender units], shape [V, 3].
        faces: Vertex indices of the faces, which all have K corners, shape [F, K].
        spacing: Distance between particles [Blender units], for the grain of the material.
        colors: Linear RGBA of the vertices, shape [V, 4].
        edges: Vertex indices of each edge, shape [E, 2]; derived from the faces by default.
        face_edges: Edge from each corner of a face to the next, shape [F, K]; goes with `edges`.
    """
    mesh.clear_geometry()
    mesh.vertices.add(len(vertices))
    mesh.loops.add(faces.size)
    mesh.polygons.add(len(faces))
    # Through attributes, as `loops.foreach_set` is several hundred times slower.
    _write(mesh, "position", "FLOAT_VECTOR", "POINT", vertices)
    _write(mesh, ".corner_vert", "INT", "CORNER", faces)
    starts = np.arange(0, faces.size, faces.shape[1], dtype=np.int32)
    mesh.polygons.foreach_set("loop_start", starts)
    if edges is not None and face_edges is not None:
        mesh.edges.add(len(edges))
        _write(mesh, ".edge_verts", "INT32_2D", "EDGE", edges)
        _write(mesh, ".corner_edge", "INT", "CORNER", face_edges)
    place = np.asarray(vertices, np.float32) / np.float32(spacing)
    _write(mesh, TEXTURE_ATTRIBUTE, "FLOAT_VECTOR", "POINT", place)
    size = np.full(len(vertices), spacing, np.float32)
    _write(mesh, SPACING_ATTRIBUTE, "FLOAT", "POINT", size)
    if colors is not None:
        _write(mesh, COLOR_ATTRIBUTE, "FLOAT_COLOR", "POINT", colors)
        mesh.attributes.active_color_name = COLOR_ATTRIBUTE
        mesh.attributes.default_color_name = COLOR_ATTRIBUTE
    mesh.update(calc_edges=edges is None)


def _write(
    mesh: bpy.types.Mesh, name: str, kind: str, domain: str, values: NDArray[np.generic]
) -> None:
    layer = mesh.attributes.get(name) or mesh.attributes.new(name, kind, domain)
    key = {"FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color"}.get(kind, "value")
    number = np.int32 if kind.startswith("INT") else np.float32
    layer.data.foreach_set(key, np.ascontiguousarray(values, number).ravel())
