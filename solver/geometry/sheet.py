# SPDX-License-Identifier: GPL-3.0-or-later
"""A thin closed body around a flat open mesh, so that clay meets it from both sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def sheet_triangles(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32], normal: ArrayLike
) -> NDArray[np.int32]:
    """The triangles of a thin body whose vertices `sheet_vertices` gives.

    Args:
        vertices: Of the flat mesh, shape [V, 3].
        triangles: Of the flat mesh, wound either way, shape [F, 3].
        normal: Of its plane, shape [3].

    Returns:
        Counter-clockwise seen from outside: both sides and the rim, shape [2 F + 2 B, 3] for B
        edges of the rim.
    """
    corners = vertices[triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    turned = facing @ np.asarray(normal, np.float64) < 0.0
    upper = np.where(turned[:, None], triangles[:, ::-1], triangles)
    count = len(vertices)
    edges = np.concatenate([upper[:, [0, 1]], upper[:, [1, 2]], upper[:, [2, 0]]])
    # An edge inside the mesh is there in both directions.
    keys = edges[:, 0].astype(np.int64) * count + edges[:, 1]
    opposite = edges[:, 1].astype(np.int64) * count + edges[:, 0]
    start, end = edges[~np.isin(keys, opposite)].T
    rim = [
        np.column_stack([start, start + count, end + count]),
        np.column_stack([start, end + count, end]),
    ]
    lower = upper[:, ::-1] + count
    return np.concatenate([upper, lower, *rim]).astype(np.int32)


def sheet_vertices(
    vertices: NDArray[np.float64], normal: ArrayLike, thickness: float
) -> NDArray[np.float64]:
    """The vertices of a thin body around a flat mesh: its upper side, then its lower one.

    Args:
        vertices: Of the flat mesh, shape [V, 3].
        normal: Unit normal of its plane, shape [3].
        thickness: Of the body, in the unit of the vertices.

    Returns:
        Shape [2 V, 3].
    """
    offset = 0.5 * thickness * np.asarray(normal, np.float64)
    return np.concatenate([vertices + offset, vertices - offset])
