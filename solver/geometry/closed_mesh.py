# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks whether a triangle mesh encloses a volume, and cleans it up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import TactileClayError
from .shells import (
    connected_labels,
    edge_pairs,
    face_edges,
    shell_labels,
    shell_signs,
    shell_volumes,
)
from .weld import near_labels

_WELD_DISTANCES = (1e-6, 1e-5, 1e-4)
"""Welding distances for open seams, relative to the mesh's size; tried until it is closed."""
_MAX_WELD = 0.1
"""Largest welding distance, relative to the median edge length."""
_FLAT = 1e-9
"""Largest volume of a shell that counts as flat, relative to the cube of its size."""


class MeshError(TactileClayError, ValueError):
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


@dataclass(frozen=True, eq=False)
class ClosedMesh:
    """A mesh that encloses a volume, and what was changed to make it so."""

    vertices: NDArray[np.float64]
    """Corner positions [m], shape [V, 3]; all are used, and no two coincide."""
    faces: NDArray[np.int32]
    """Corner indices, shape [F, 3]: bodies are wound outward, cavities inward."""
    shell: NDArray[np.int64]
    """Shell of each face, shape [F]."""
    sources: NDArray[np.int64]
    """Index of each face in the original mesh, shape [F]."""
    turned: NDArray[np.bool_]
    """Whether each face was flipped, shape [F]."""
    notes: tuple[str, ...]
    """What was changed, as sentences for the user."""

    @property
    def shell_count(self) -> int:
        """Number of connected surfaces."""
        return int(self.shell.max()) + 1


def check_closed_mesh(
    vertices: ArrayLike, faces: ArrayLike, *, name: str = "The mesh"
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Clean up a mesh with `closed_mesh`, and return its vertices and faces.

    Raises:
        MeshError: See `closed_mesh`.
    """
    mesh = closed_mesh(vertices, faces, name=name)
    return mesh.vertices, mesh.faces


def closed_mesh(vertices: ArrayLike, faces: ArrayLike, *, name: str = "The mesh") -> ClosedMesh:
    """Clean up a mesh such as files contain, or explain why it encloses no volume.

    Vertices at exactly the same position are merged, since split normals and texture seams
    duplicate them; so are nearly coincident vertices along open seams. Unused vertices, faces
    without area, duplicate faces and flat shells are removed. Each shell is judged by itself: one
    outside all others is a body whichever way it is wound; one inside another is a cavity if it is
    wound the opposite way.

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3].
        name: Name of the mesh in error messages.

    Raises:
        MeshError: The mesh has coordinates that are not finite, no faces, indices out of range,
            holes (the message tells how many), edges where an odd number of faces meet,
            inconsistent winding, or no volume.
    """
    points, corners = _checked_arrays(vertices, faces, name)
    notes: list[str] = []
    used = np.unique(corners)
    if len(used) < len(points):
        notes.append(f"{_count(len(points) - len(used), 'vertex')} without faces removed.")
    weld = np.zeros(len(points), np.int64)
    points, weld[used] = _distinct_points(points[used])
    corners = weld[corners]
    sources = np.arange(len(corners))
    corners, sources = _proper(corners, sources, name)
    if len(open_edges(corners)):
        points, corners, sources = _welded(points, corners, sources, notes)
    corners, sources, duplicates = _single_faces(corners, sources, name)
    if duplicates:
        notes.append(f"{_count(duplicates, 'duplicate face')} removed.")
    # Faces that shared an edge in the original mesh belong together whatever else lies there.
    given = np.asarray(faces, np.int64)[sources]
    label = shell_labels(corners, edge_pairs(given))
    _check_shells(corners, label, name)
    volumes = shell_volumes(points, corners, label)
    flat = np.abs(volumes) <= _FLAT * _sizes(points, corners, label) ** 3
    if flat.all():
        raise MeshError(f"{name} encloses no volume: it is flat, or its parts cancel out.")
    if flat.any():
        notes.append(f"{_count(int(flat.sum()), 'flat part')} removed.")
        kept = ~flat[label]
        corners, sources = corners[kept], sources[kept]
        label = np.unique(label[kept], return_inverse=True)[1].reshape(-1)
        volumes = volumes[~flat]
    turn = shell_signs(points, corners, label, volumes) != np.sign(volumes)
    turned = turn[label]
    if turn.any() and not turn.all():
        notes.append(f"{int(turn.sum())} of {len(turn)} bodies were inside out; they were flipped.")
    corners = np.where(turned[:, None], corners[:, ::-1], corners)
    used, corners = np.unique(corners, return_inverse=True)
    return ClosedMesh(
        points[used],
        np.ascontiguousarray(corners.reshape(-1, 3), np.int32),
        label,
        sources,
        turned,
        tuple(notes),
    )


def open_edges(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Edges of only one face, shape [E, 2]."""
    edges, uses = np.unique(np.sort(face_edges(faces), axis=1), axis=0, return_counts=True)
    return edges[uses == 1]


def group_count(edges: NDArray[np.int64]) -> int:
    """Number of connected groups of edges; each hole is one group of open edges."""
    ends = np.unique(edges, return_inverse=True)[1].reshape(-1, 2)
    return int(connected_labels(ends, int(ends.max()) + 1).max()) + 1


def _checked_arrays(
    vertices: ArrayLike, faces: ArrayLike, name: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
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
        raise MeshError(f"{name} has a face that refers to a vertex that does not exist.")
    return points, corners


def _distinct_points(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distinct points, and the index of each point among them."""
    # Adding 0 turns negative zeros into positive ones.
    order = np.lexsort((points + 0.0).T)
    ordered = points[order]
    new = np.r_[True, (ordered[1:] != ordered[:-1]).any(1)]
    place = np.empty(len(points), np.int64)
    place[order] = np.cumsum(new) - 1
    return ordered[new], place


def _proper(
    corners: NDArray[np.int64], sources: NDArray[np.int64], name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Keep the faces with three different corners."""
    proper = (corners != np.roll(corners, 1, axis=1)).all(1)
    if not proper.any():
        raise MeshError(f"{name} has only faces without area.")
    return corners[proper], sources[proper]


def _welded(
    points: NDArray[np.float64],
    corners: NDArray[np.int64],
    sources: NDArray[np.int64],
    notes: list[str],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Weld open seams with the distance that leaves the fewest open edges."""
    size = float(np.ptp(points[np.unique(corners)], axis=0).max())
    edges = face_edges(corners)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    median_edge = float(np.median(lengths))
    seam = np.unique(open_edges(corners))
    best = (len(open_edges(corners)), corners, sources, 0)
    for share in _WELD_DISTANCES:
        distance = min(share * size, _MAX_WELD * median_edge)
        place = np.arange(len(points))
        label = near_labels(points[seam], distance)
        first = np.full(int(label.max()) + 1, len(points))
        np.minimum.at(first, label, seam)
        place[seam] = first[label]
        joined = place[corners]
        proper = (joined != np.roll(joined, 1, axis=1)).all(1)
        moved = int((place != np.arange(len(points))).sum())
        left = len(open_edges(joined[proper]))
        if left < best[0] and proper.any():
            best = (left, joined[proper], sources[proper], moved)
        if left == 0:
            break
    if best[3]:
        notes.append(f"{_count(best[3], 'vertex')} along open seams welded.")
    return points, best[1], best[2]


def _single_faces(
    corners: NDArray[np.int64], sources: NDArray[np.int64], name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Remove duplicate faces; also returns how many were removed.

    Coincident faces wound opposite ways are both removed, since bodies that share a wall are one.
    But of a whole body that is duplicated inside out, one copy is kept.
    """
    order = np.sort(corners, axis=1)
    lowest = np.argmin(corners, axis=1)
    second = np.take_along_axis(corners, ((lowest + 1) % 3)[:, None], 1)[:, 0]
    direction = np.where(second == order[:, 1], 1, -1)
    _, first, group = np.unique(order, axis=0, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    if len(first) == len(corners):
        return corners, sources, 0
    balance = np.bincount(group, weights=direction, minlength=len(first)).astype(np.int64)
    label = connected_labels(edge_pairs(order[first]), len(first))
    cancelled = np.bincount(label, weights=balance != 0) == 0
    cancelled[label[_on_open_edge(order[first])]] = False
    wanted = np.where(
        balance != 0, np.sign(balance), np.where(cancelled[label], direction[first], 0)
    )
    keep = np.zeros(len(corners), bool)
    matching = np.flatnonzero(direction == wanted[group])
    _, earliest = np.unique(group[matching], return_index=True)
    keep[matching[earliest]] = True
    if not keep.any():
        raise MeshError(f"{name} encloses no volume: it is flat, or its parts cancel out.")
    return corners[keep], sources[keep], int((~keep).sum())


def _on_open_edge(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices of faces with an open edge, given faces with sorted corners."""
    _, edge, uses = np.unique(
        np.sort(face_edges(corners), axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return np.flatnonzero((uses[edge.reshape(-1)] == 1).reshape(-1, 3).any(1))


def _check_shells(corners: NDArray[np.int64], label: NDArray[np.int64], name: str) -> None:
    """Refuse holes, edges where an odd number of faces meet, and inconsistent winding."""
    directed = face_edges(corners)
    # An edge at which shells touch counts as an edge of each.
    key = np.column_stack([np.sort(directed, axis=1), np.repeat(label, 3)])
    edges, edge, uses = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    lone = edges[uses == 1, :2]
    if len(lone):
        holes = group_count(lone)
        raise MeshError(
            f"{name} is open: it has {holes} hole{'s' if holes > 1 else ''} "
            f"({len(lone)} open edges). Close {'them' if holes > 1 else 'it'} first, for "
            "example with Merge by Distance, Fill Holes or a Remesh modifier."
        )
    if (uses % 2).any():
        raise MeshError(
            f"{name} has {int((uses % 2).sum())} edges where an odd number of faces meet, so its "
            "inside is not defined. Remove the extra faces or use a Remesh modifier."
        )
    direction = np.where(directed[:, 0] < directed[:, 1], 1, -1)
    balance = np.bincount(edge, weights=direction, minlength=len(edges))
    if np.any(balance != 0):
        raise MeshError(
            f"{name} has inconsistent normals ({int((balance != 0).sum())} edges); recalculate "
            "them to the outside."
        )


def _sizes(
    points: NDArray[np.float64], corners: NDArray[np.int64], label: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Longest side of each shell's bounding box [m]."""
    count = int(label.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for k in range(3):
        np.minimum.at(low, label, points[corners[:, k]])
        np.maximum.at(high, label, points[corners[:, k]])
    return np.asarray((high - low).max(1))


def _count(number: int, noun: str) -> str:
    plural = {"vertex": "vertices"}.get(noun, f"{noun}s")
    return f"{number:,} {noun if number == 1 else plural}"
