# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a triangle mesh encloses a volume, and what is wrong with it where it doesn't."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


class MeshError(ValueError):
    """A mesh cannot be used; the message says why and what to do."""


def mesh_volume(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> float:
    """Signed volume of a closed mesh [m³], by the divergence theorem.

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3], counter-clockwise seen from outside.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    corners = corners - corners.reshape(-1, 3).mean(0)
    cross = np.cross(corners[:, 1], corners[:, 2])
    return float(np.einsum("ij,ij->", corners[:, 0], cross) / 6.0)


def mesh_area(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> float:
    """Area of a mesh [m²].

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3].
    """
    first, second, third = np.moveaxis(np.asarray(vertices, np.float64)[faces], 1, 0)
    return float(0.5 * np.linalg.norm(np.cross(second - first, third - first), axis=1).sum())


def check_closed_mesh(
    vertices: ArrayLike, faces: ArrayLike, *, name: str = "The mesh"
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Hand back the mesh with seams welded, or say why it encloses no volume.

    Vertices at the very same position count as one, as a file with split normals or texture
    seams has them. Several bodies in one mesh are fine, and so is a consistently inverted mesh,
    which comes back turned outside.

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3].
        name: What to call the mesh in an error.

    Returns:
        Welded vertices [m], shape [V', 3], and faces, shape [F', 3], wound outward.

    Raises:
        MeshError: Non-finite coordinates, no faces, indices out of range, holes (their number is
            named), edges with more than two faces, inconsistent winding, or no volume.
    """
    points = np.asarray(vertices, np.float64)
    corners = np.asarray(faces, np.int64)
    if points.ndim != 2 or points.shape[1] != 3 or corners.ndim != 2 or corners.shape[1] != 3:
        raise MeshError(
            f"{name} must have vertices of shape [V, 3] and triangles of shape [F, 3]; "
            f"it has {points.shape} and {corners.shape}."
        )
    if len(points) == 0 or len(corners) == 0:
        raise MeshError(f"{name} has no faces, so there is nothing to fill.")
    if not np.isfinite(points).all():
        bad = int((~np.isfinite(points).all(1)).sum())
        raise MeshError(
            f"{name} has {bad} vertices that are not finite (NaN or infinite); delete or fix them."
        )
    if corners.min() < 0 or corners.max() >= len(points):
        raise MeshError(f"{name} has a face that names a vertex that is not there.")

    points, welded = np.unique(points, axis=0, return_inverse=True)
    corners = welded.reshape(-1)[corners]
    proper = (
        (corners[:, 0] != corners[:, 1])
        & (corners[:, 1] != corners[:, 2])
        & (corners[:, 2] != corners[:, 0])
    )
    corners = corners[proper]
    if len(corners) == 0:
        raise MeshError(f"{name} has only faces without area.")

    directed = corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    open_edges = edges[uses == 1]
    if len(open_edges):
        holes = group_count(open_edges)
        raise MeshError(
            f"{name} is open: it has {holes} hole{'s' if holes > 1 else ''} "
            f"({len(open_edges)} open edges). Close {'them' if holes > 1 else 'it'} first, for "
            "example with Fill Holes or a Remesh modifier."
        )
    if (uses % 2).any():
        raise MeshError(
            f"{name} has {int((uses % 2).sum())} edges where an odd number of faces meet, so its "
            "inside is not defined. Remove the extra faces or use a Remesh modifier."
        )
    direction = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    _, which = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    balance = np.bincount(which.reshape(-1), weights=direction, minlength=len(edges))
    if np.any(balance != 0):
        raise MeshError(
            f"{name} has faces that point different ways ({int((balance != 0).sum())} edges); "
            "recalculate its normals to the outside."
        )
    volume = mesh_volume(points, corners)
    extent = float(np.ptp(points, axis=0).max())
    if abs(volume) <= 1e-9 * extent**3:
        raise MeshError(f"{name} encloses no volume: it is flat, or its parts cancel out.")
    if volume < 0:
        corners = corners[:, ::-1]
    return points, np.ascontiguousarray(corners, np.int32)


def group_count(edges: NDArray[np.int64]) -> int:
    """Number of connected groups that a set of edges forms (a hole is one such group)."""
    _, ends = np.unique(edges, return_inverse=True)
    ends = ends.reshape(-1, 2)
    label = np.arange(ends.max() + 1)
    while True:
        lowest = np.minimum(label[ends[:, 0]], label[ends[:, 1]])
        updated = label.copy()
        np.minimum.at(updated, ends[:, 0], lowest)
        np.minimum.at(updated, ends[:, 1], lowest)
        if np.array_equal(updated, label):
            return len(np.unique(label))
        label = updated
