# SPDX-License-Identifier: GPL-3.0-or-later
"""Ghost particles on the surface of a closed mesh, which carry contact (paper, section III-D).

Barreiro, Torres and Otaduy rasterize ghost particles on a solid in its rest configuration and move
them with it. Here they lie on the surface, each carried by a triangle, and each represents the part
of the surface nearest to it, so that their areas add up to that of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..core.recording_lock import recording_lock

COVER_RADIUS = 0.57
"""A ghost covers the surface this far around it, in ghost spacings."""
CANDIDATE_SPACING = 0.2
"""Longest edge of the surface pieces among which ghosts are chosen, in ghost spacings.

No point of a piece is farther from its centroid than two thirds of that, so that no point of the
surface is farther than 0.57 + 0.133 < 1/√2 spacings from a ghost: as dense as a square lattice.
"""
SLENDER = 5.0
"""Triangles with a larger longest edge squared over area are halved first; equilateral: 2.3."""
SAME_SIDE = 0.5
"""Ghosts cover only surface whose normal has at least this cosine with theirs."""
_GRID_CELLS = 64
_COVER_CELLS = 128


@dataclass(frozen=True)
class SurfaceGhosts:
    """Ghost particles carried by the triangles of a mesh."""

    face: NDArray[np.int32]
    """Triangle that carries each ghost, shape [G]."""
    weights: NDArray[np.float64]
    """Barycentric coordinates in that triangle, shape [G, 3]."""
    area: NDArray[np.float64]
    """Surface area that each represents, in the rest shape [m²], shape [G]."""

    def positions(
        self, vertices: NDArray[np.floating], faces: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """Ghost positions for given vertex positions [m], shape [G, 3]."""
        corners = np.asarray(vertices, np.float64)[np.asarray(faces)[self.face]]
        return np.einsum("gk,gkd->gd", self.weights, corners)

    def normals(
        self, vertices: NDArray[np.floating], faces: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """Their outward unit normals, for faces that wind outward, shape [G, 3]."""
        return _face_normals(np.asarray(vertices, np.float64), np.asarray(faces))[self.face]


def rasterize_ghosts(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], spacing: float
) -> SurfaceGhosts:
    """Cover a mesh in its rest shape with ghosts.

    No point of the surface is farther than ``spacing`` / √2 from a ghost on its own side, so that
    a particle of radius ``spacing`` cannot slip between them.

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Triangles, shape [F, 3], wound outward.
        spacing: Distance of ghosts [m].

    Raises:
        ValueError: The spacing is not a positive number.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise ValueError(f"The ghost spacing is {spacing!r} m; it must be above 0.")
    points = np.asarray(vertices, np.float64)
    triangles = np.asarray(faces, np.int64)
    face, weights, area = _cut_faces(points, triangles, CANDIDATE_SPACING * spacing)
    place = np.einsum("gk,gkd->gd", weights, points[triangles[face]])
    normal = _face_normals(points, triangles)[face]
    chosen, owner = _cover(place, normal, COVER_RADIUS * spacing)
    return SurfaceGhosts(
        face=face[chosen].astype(np.int32),
        weights=weights[chosen],
        area=np.bincount(owner, weights=area, minlength=len(chosen)),
    )


def _face_normals(points: NDArray[np.float64], triangles: NDArray[np.integer]) -> NDArray:
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.maximum(length, np.finfo(float).tiny)


def _cut_faces(
    points: NDArray[np.float64], triangles: NDArray[np.int64], longest: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Cut triangles into pieces with edges up to ``longest`` [m].

    Returns:
        For each piece its triangle, the barycentric coordinates of its centroid, and its area.
    """
    face, corners, area = _cut_slivers(points, triangles, longest)
    place = corners @ points[triangles[face]]
    edges = np.linalg.norm(place - np.roll(place, -1, axis=1), axis=2).max(1)
    cuts = np.maximum(np.ceil(edges / longest - 1e-9).astype(np.int64), 1)
    faces, weights, areas = [], [], []
    for count in np.unique(cuts):
        pieces = np.flatnonzero(cuts == count)
        first, second = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
        upright = first + second < count
        inverted = first + second < count - 1
        inner = np.concatenate(
            [
                np.stack([first[upright] + 1 / 3, second[upright] + 1 / 3], 1),
                np.stack([first[inverted] + 2 / 3, second[inverted] + 2 / 3], 1),
            ]
        )
        inner = np.column_stack([1.0 - inner.sum(1) / count, inner / count])
        faces.append(np.repeat(face[pieces], len(inner)))
        weights.append((inner @ corners[pieces]).reshape(-1, 3))
        areas.append(np.repeat(area[pieces] / count**2, len(inner)))
    return np.concatenate(faces), np.concatenate(weights), np.concatenate(areas)


def _cut_slivers(
    points: NDArray[np.float64], triangles: NDArray[np.int64], longest: float
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Halve slender triangles across their longest edges until they are stout or short.

    Returns:
        For each piece its triangle, the barycentric coordinates of its corners, and its area.
    """
    place = points[triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0]), axis=1
    )
    face = np.flatnonzero(area > 0.0)
    area = area[face]
    corners = np.tile(np.eye(3), (len(face), 1, 1))
    done = []
    while len(face):
        place = corners @ points[triangles[face]]
        edges = np.linalg.norm(place - np.roll(place, -1, axis=1), axis=2)
        slender = (edges.max(1) > longest) & (edges.max(1) ** 2 > SLENDER * area)
        done.append((face[~slender], corners[~slender], area[~slender]))
        face, corners, area = face[slender], corners[slender], area[slender]
        row, edge = np.arange(len(face)), edges[slender].argmax(1)
        first, second = corners[row, edge], corners[row, (edge + 1) % 3]
        apex, middle = corners[row, (edge + 2) % 3], 0.5 * (first + second)
        halves = [np.stack([first, middle, apex], 1), np.stack([middle, second, apex], 1)]
        face, corners, area = np.tile(face, 2), np.concatenate(halves), np.tile(0.5 * area, 2)
    faces, pieces, areas = zip(*done, strict=True)
    return np.concatenate(faces), np.concatenate(pieces), np.concatenate(areas)


@wp.kernel(enable_backward=False)
def choose_cover(
    grid: wp.uint64,
    radius: float,
    order: wp.array[int],
    place: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    nearest: wp.array[float],
    owner: wp.array[int],
    chosen: wp.array[int],
    chosen_count: wp.array[int],
) -> None:
    """Choose points one after another, in a single thread, until all points are covered."""
    used = int(0)
    for turn in range(order.shape[0]):
        i = order[turn]
        if owner[i] < 0:
            x = place[i]
            for j in wp.hash_grid_query(grid, x, radius):
                distance = wp.length(place[j] - x)
                same_side = wp.dot(normal[j], normal[i]) > SAME_SIDE
                if same_side and distance < wp.min(radius, nearest[j]):
                    nearest[j] = distance
                    owner[j] = used
            nearest[i] = 0.0
            owner[i] = used
            chosen[used] = i
            used += 1
    chosen_count[0] = used


def _cover(
    place: NDArray[np.float64], normal: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Choose points until every point has a chosen one within the radius, on the same side.

    Returns:
        Indices of the chosen points, and for each point the nearest chosen one on its side.
    """
    count = len(place)
    # Neighbors in space become neighbors in memory, which is several times faster.
    cell = np.floor((place - place.min(0)) / radius).astype(np.int64)
    sorting = np.lexsort(cell.T)
    # In random order: along the rows of a cut triangle, each ghost would cover half of what the
    # one before it covers.
    order = np.random.default_rng(0).permutation(count)
    with recording_lock:
        # About their middle, where float32 resolves them best.
        points = wp.array((place - place.mean(0))[sorting], dtype=wp.vec3, device="cpu")
        grid = wp.HashGrid(_COVER_CELLS, _COVER_CELLS, _COVER_CELLS, device="cpu")
        grid.build(points, radius)
        owner = wp.full(count, -1, dtype=int, device="cpu")
        chosen = wp.zeros(count, dtype=int, device="cpu")
        chosen_count = wp.zeros(1, dtype=int, device="cpu")
        wp.launch(
            choose_cover,
            dim=1,
            inputs=[
                grid.id,
                radius,
                wp.array(order, dtype=int, device="cpu"),
                points,
                wp.array(normal[sorting], dtype=wp.vec3, device="cpu"),
                wp.full(count, np.inf, dtype=float, device="cpu"),
                owner,
                chosen,
                chosen_count,
            ],
            device="cpu",
        )
    owners = np.empty(count, np.int32)
    owners[sorting] = owner.numpy()
    return sorting[chosen.numpy()[: chosen_count.numpy()[0]]], owners


@wp.kernel(enable_backward=False)
def carry_ghosts(
    face: wp.array[int],
    weights: wp.array[wp.vec3],
    orientation: wp.array[float],
    row: int,
    indices: wp.array[int],
    points: wp.array[wp.vec3],
    motion: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    drift: wp.array[wp.vec3],
) -> None:
    """Place ghosts in their triangles."""
    g = wp.tid()
    a = indices[3 * face[g]]
    b = indices[3 * face[g] + 1]
    c = indices[3 * face[g] + 2]
    w = weights[g]
    position[g] = points[a] * w[0] + points[b] * w[1] + points[c] * w[2]
    drift[g] = motion[a] * w[0] + motion[b] * w[1] + motion[c] * w[2]
    outward = wp.cross(points[b] - points[a], points[c] - points[a])
    normal[g] = wp.normalize(outward) * orientation[row]


class GhostMesh:
    """The ghosts of one mesh on the device, in the mesh's coordinates, with a grid to find them.

    Args:
        ghosts: The ghosts.
        reach: Largest distance at which they are searched for [m].
        device: Warp device.
    """

    def __init__(self, ghosts: SurfaceGhosts, reach: float, device: wp.Device) -> None:
        count = len(ghosts.face)
        self.count = count
        self.reach = reach
        self.device = device
        self.face = wp.array(ghosts.face, dtype=int, device=device)
        self.weights = wp.array(ghosts.weights, dtype=wp.vec3, device=device)
        self.area = wp.array(ghosts.area, dtype=float, device=device)
        """In the rest shape [m²]."""
        self.position = wp.zeros(count, dtype=wp.vec3, device=device)
        """[m]"""
        self.normal = wp.zeros(count, dtype=wp.vec3, device=device)
        """Outward."""
        self.drift = wp.zeros(count, dtype=wp.vec3, device=device)
        """Their motion in a substep due to the mesh's change of shape [m]."""
        self.grid = wp.HashGrid(_GRID_CELLS, _GRID_CELLS, _GRID_CELLS, device=device)

    def carry(self, mesh: wp.Mesh, orientation: wp.array, row: int) -> None:
        """Follow the mesh to its current vertices.

        Args:
            mesh: The mesh; its velocities hold the motion of vertices in a substep [m].
            orientation: 1 for each mesh that winds outward, -1 for one turned inside out.
            row: The mesh's index in ``orientation``.
        """
        wp.launch(
            carry_ghosts,
            dim=self.count,
            inputs=[
                self.face,
                self.weights,
                orientation,
                row,
                mesh.indices,
                mesh.points,
                mesh.velocities,
                self.position,
                self.normal,
                self.drift,
            ],
            device=self.device,
        )
        self.grid.build(self.position, self.reach)
