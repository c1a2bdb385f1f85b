# SPDX-License-Identifier: GPL-3.0-or-later
"""Ghost particles on the surface of a closed mesh, which represent it in contact.

Barreiro, Torres and Otaduy (WHC 2021, section III-D) rasterize ghost particles on a solid in its
rest configuration and move them with it. Here they lie on the surface, each in a triangle. Each
represents the part of the surface nearest to it, so that their areas sum to the mesh's area.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..core.recording_lock import recording_lock

COVER_RADIUS = 0.57
"""Radius of the surface that a ghost covers, in ghost spacings."""
CANDIDATE_SPACING = 0.2
"""Longest edge of the surface pieces among which ghosts are chosen, in ghost spacings.

No point of a piece is farther from its centroid than two thirds of that. Thus no point of the
surface is farther than 0.57 + 0.133 < 1/√2 spacings from a ghost, as in a square lattice.
"""
SLENDER = 5.0
"""Triangles whose squared longest edge over area exceeds this are halved first (equilateral
triangles have 2.3)."""
SAME_SIDE = 0.5
"""Ghosts cover only points whose normals have at least this cosine with theirs."""
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
    """Surface area that each ghost represents, in the rest shape [m²], shape [G]."""

    def positions(
        self, vertices: NDArray[np.floating], faces: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """Positions of the ghosts for given vertex positions [m], shape [G, 3]."""
        corners = np.asarray(vertices, np.float64)[np.asarray(faces)[self.face]]
        return np.einsum("gk,gkd->gd", self.weights, corners)

    def normals(
        self, vertices: NDArray[np.floating], faces: NDArray[np.integer]
    ) -> NDArray[np.float64]:
        """Outward unit normals of the ghosts, for faces wound outward, shape [G, 3]."""
        return _face_normals(np.asarray(vertices, np.float64), np.asarray(faces))[self.face]


def rasterize_ghosts(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], spacing: float
) -> SurfaceGhosts:
    """Cover a mesh in its rest shape with ghosts.

    No point of the surface is farther than ``spacing`` / √2 from a ghost on its own side, so that
    a particle of radius ``spacing`` cannot slip between them.

    Args:
        vertices: Vertex positions [m], shape [V, 3].
        faces: Triangles, shape [F, 3], wound outward.
        spacing: Distance between ghosts [m].

    Raises:
        ValueError: The spacing is not a positive number.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise ValueError(f"The ghost spacing is {spacing!r} m; it must be above 0.")
    points = np.asarray(vertices, np.float64)
    triangles = np.asarray(faces, np.int64)
    face, weights, area = _cut_faces(points, triangles, CANDIDATE_SPACING * spacing)
    position = np.einsum("gk,gkd->gd", weights, points[triangles[face]])
    normal = _face_normals(points, triangles)[face]
    chosen, owner = _cover(position, normal, COVER_RADIUS * spacing)
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
    position = corners @ points[triangles[face]]
    edges = np.linalg.norm(position - np.roll(position, -1, axis=1), axis=2).max(1)
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
    """Halve slender triangles across their longest edges until they are no longer slender or long.

    Returns:
        For each piece its triangle, the barycentric coordinates of its corners, and its area.
    """
    position = points[triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]), axis=1
    )
    face = np.flatnonzero(area > 0.0)
    area = area[face]
    corners = np.tile(np.eye(3), (len(face), 1, 1))
    done = []
    while len(face):
        position = corners @ points[triangles[face]]
        edges = np.linalg.norm(position - np.roll(position, -1, axis=1), axis=2)
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
    position: wp.array[wp.vec3],
    normal: wp.array[wp.vec3],
    nearest: wp.array[float],
    owner: wp.array[int],
    chosen: wp.array[int],
    chosen_count: wp.array[int],
) -> None:
    """Choose points one by one, in a single thread, until all points are covered."""
    used = int(0)
    for index in range(order.shape[0]):
        i = order[index]
        if owner[i] < 0:
            x = position[i]
            for j in wp.hash_grid_query(grid, x, radius):
                distance = wp.length(position[j] - x)
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
    position: NDArray[np.float64], normal: NDArray[np.float64], radius: float
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Choose points until every point has a chosen one within the radius, on the same side.

    Returns:
        Indices of the chosen points, and for each point the nearest chosen one on its side.
    """
    count = len(position)
    # Sorting neighbors in space next to each other in memory is several times faster.
    cell = np.floor((position - position.min(0)) / radius).astype(np.int64)
    sorting = np.lexsort(cell.T)
    # In random order, because along the rows of a cut triangle each ghost would cover half of the
    # points that the previous one covers.
    order = np.random.default_rng(0).permutation(count)
    with recording_lock:
        # Centered, where float32 has the highest resolution.
        points = wp.array((position - position.mean(0))[sorting], dtype=wp.vec3, device="cpu")
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
    """Move ghosts with their triangles."""
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
    """The ghosts of one mesh on the device, in the mesh's coordinates, with a search grid.

    Args:
        ghosts: The ghosts.
        reach: Largest search distance [m].
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
        """Area in the rest shape [m²]."""
        self.position = wp.zeros(count, dtype=wp.vec3, device=device)
        """[m]"""
        self.normal = wp.zeros(count, dtype=wp.vec3, device=device)
        """Outward unit normals."""
        self.drift = wp.zeros(count, dtype=wp.vec3, device=device)
        """Motion in a substep due to the mesh's deformation [m]."""
        self.grid = wp.HashGrid(_GRID_CELLS, _GRID_CELLS, _GRID_CELLS, device=device)

    def carry(self, mesh: wp.Mesh, orientation: wp.array, row: int) -> None:
        """Move the ghosts to the mesh's current vertices.

        Args:
            mesh: The mesh; its velocities hold the motion of vertices in a substep [m].
            orientation: 1 for each mesh wound outward, -1 for one that is inside out.
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
