# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a triangle mesh encloses a volume, and what is wrong with it where it doesn't."""

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
"""Open seams are welded within these, over the size of the mesh, the first that closes it."""
_WELD_OF_EDGE = 0.1
"""And never farther than this part of a usual edge."""
_FLAT = 1e-9
"""A shell of less volume than this is flat, over the cube of its size."""


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
    """A mesh that encloses a volume, and what had to be done to have it so."""

    vertices: NDArray[np.float64]
    """Corner positions [m], shape [V, 3]; each is used, and no two are at one place."""
    faces: NDArray[np.int32]
    """Corner indices, shape [F, 3]: bodies are wound outward, cavities inward."""
    shell: NDArray[np.int64]
    """Shell of each face, shape [F]."""
    sources: NDArray[np.int64]
    """Which of the faces that were given each face is, shape [F]."""
    turned: NDArray[np.bool_]
    """Whether a face is wound the other way round than it was given, shape [F]."""
    notes: tuple[str, ...]
    """What was done, each as a sentence for people."""

    @property
    def shell_count(self) -> int:
        """Number of connected surfaces."""
        return int(self.shell.max()) + 1


def check_closed_mesh(
    vertices: ArrayLike, faces: ArrayLike, *, name: str = "The mesh"
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the mesh that `closed_mesh` makes of it, as vertices and faces.

    Raises:
        MeshError: As for `closed_mesh`.
    """
    mesh = closed_mesh(vertices, faces, name=name)
    return mesh.vertices, mesh.faces


def closed_mesh(vertices: ArrayLike, faces: ArrayLike, *, name: str = "The mesh") -> ClosedMesh:
    """Make a clean closed mesh out of one as files have it, or say why it encloses no volume.

    Vertices at the very same position count as one, as a file with split normals or texture seams
    has them; so do those along open seams that are all but at one place. Vertices that no face
    uses, faces without area, doubled faces and flat shells are left out. Each shell is judged by
    itself: one outside all others is a body whichever way it is wound, one inside another is a
    cavity where it is wound the other way round.

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Corner indices, shape [F, 3].
        name: What to call the mesh in an error.

    Raises:
        MeshError: Non-finite coordinates, no faces, indices out of range, holes (their number is
            named), edges with more than two faces, inconsistent winding, or no volume.
    """
    points, corners = _checked_arrays(vertices, faces, name)
    notes: list[str] = []
    used = np.unique(corners)
    if len(used) < len(points):
        notes.append(f"{_count(len(points) - len(used), 'vertex')} without faces left out.")
    weld = np.zeros(len(points), np.int64)
    points, weld[used] = _at_one_place(points[used])
    corners = weld[corners]
    sources = np.arange(len(corners))
    corners, sources = _proper(corners, sources, name)
    if len(open_edges(corners)):
        points, corners, sources = _welded(points, corners, sources, notes)
    corners, sources, doubled = _single_faces(corners, sources, name)
    if doubled:
        notes.append(f"{_count(doubled, 'doubled face')} left out.")
    # Faces that shared an edge as they were given belong together whatever else lies there.
    given = np.asarray(faces, np.int64)[sources]
    label = shell_labels(corners, edge_pairs(given))
    _check_shells(corners, label, name)
    volumes = shell_volumes(points, corners, label)
    flat = np.abs(volumes) <= _FLAT * _sizes(points, corners, label) ** 3
    if flat.all():
        raise MeshError(f"{name} encloses no volume: it is flat, or its parts cancel out.")
    if flat.any():
        notes.append(f"{_count(int(flat.sum()), 'flat part')} left out.")
        kept = ~flat[label]
        corners, sources = corners[kept], sources[kept]
        label = np.unique(label[kept], return_inverse=True)[1].reshape(-1)
        volumes = volumes[~flat]
    turn = shell_signs(points, corners, label, volumes) != np.sign(volumes)
    turned = turn[label]
    if turn.any() and not turn.all():
        notes.append(f"{int(turn.sum())} of {len(turn)} bodies were inside out and were turned.")
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
    """Edges that only one face has, shape [E, 2]."""
    edges, uses = np.unique(np.sort(face_edges(faces), axis=1), axis=0, return_counts=True)
    return edges[uses == 1]


def group_count(edges: NDArray[np.int64]) -> int:
    """Number of connected groups that a set of edges forms (a hole is one such group)."""
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
        raise MeshError(f"{name} has a face that names a vertex that is not there.")
    return points, corners


def _at_one_place(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distinct points, and which of them each point is."""
    # Adding 0 makes a negative zero a positive one.
    order = np.lexsort((points + 0.0).T)
    ordered = points[order]
    new = np.r_[True, (ordered[1:] != ordered[:-1]).any(1)]
    place = np.empty(len(points), np.int64)
    place[order] = np.cumsum(new) - 1
    return ordered[new], place


def _proper(
    corners: NDArray[np.int64], sources: NDArray[np.int64], name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Faces with three different corners."""
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
    """The mesh with its open seams welded as far as that closes it."""
    size = float(np.ptp(points[np.unique(corners)], axis=0).max())
    edges = face_edges(corners)
    usual = float(np.median(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)))
    seam = np.unique(open_edges(corners))
    best = (len(open_edges(corners)), corners, sources, 0)
    for share in _WELD_DISTANCES:
        distance = min(share * size, _WELD_OF_EDGE * usual)
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
    """Each face once, and how many were left out.

    Where faces lie on each other back to back, neither bounds the whole: bodies that share a wall
    are one. But a body that is there a second time, inside out, is there.
    """
    order = np.sort(corners, axis=1)
    lowest = np.argmin(corners, axis=1)
    second = np.take_along_axis(corners, ((lowest + 1) % 3)[:, None], 1)[:, 0]
    direction = np.where(second == order[:, 1], 1, -1)
    _, first, which = np.unique(order, axis=0, return_index=True, return_inverse=True)
    which = which.reshape(-1)
    if len(first) == len(corners):
        return corners, sources, 0
    balance = np.bincount(which, weights=direction, minlength=len(first)).astype(np.int64)
    label = connected_labels(edge_pairs(order[first]), len(first))
    cancelled = np.bincount(label, weights=balance != 0) == 0
    cancelled[label[_on_open_edge(order[first])]] = False
    wanted = np.where(
        balance != 0, np.sign(balance), np.where(cancelled[label], direction[first], 0)
    )
    keep = np.zeros(len(corners), bool)
    matching = np.flatnonzero(direction == wanted[which])
    _, earliest = np.unique(which[matching], return_index=True)
    keep[matching[earliest]] = True
    if not keep.any():
        raise MeshError(f"{name} encloses no volume: it is flat, or its parts cancel out.")
    return corners[keep], sources[keep], int((~keep).sum())


def _on_open_edge(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Faces with an edge that no other face has, of faces with sorted corners."""
    _, which, uses = np.unique(
        np.sort(face_edges(corners), axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return np.flatnonzero((uses[which.reshape(-1)] == 1).reshape(-1, 3).any(1))


def _check_shells(corners: NDArray[np.int64], label: NDArray[np.int64], name: str) -> None:
    """Refuse holes, edges where an odd number of faces meet, and inconsistent winding."""
    directed = face_edges(corners)
    # An edge at which shells touch is an edge of each.
    key = np.column_stack([np.sort(directed, axis=1), np.repeat(label, 3)])
    edges, which, uses = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    which = which.reshape(-1)
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
    balance = np.bincount(which, weights=direction, minlength=len(edges))
    if np.any(balance != 0):
        raise MeshError(
            f"{name} has faces that point different ways ({int((balance != 0).sum())} edges); "
            "recalculate its normals to the outside."
        )


def _sizes(
    points: NDArray[np.float64], corners: NDArray[np.int64], label: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Longest side of each shell's box [m]."""
    count = int(label.max()) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for k in range(3):
        np.minimum.at(low, label, points[corners[:, k]])
        np.maximum.at(high, label, points[corners[:, k]])
    return np.asarray((high - low).max(1))


def _count(number: int, what: str) -> str:
    plural = {"vertex": "vertices"}.get(what, f"{what}s")
    return f"{number:,} {what if number == 1 else plural}"
