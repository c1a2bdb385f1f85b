# SPDX-License-Identifier: GPL-3.0-or-later
"""Tetrahedra of a body-centered cubic lattice, and points carried by tetrahedra.

All tetrahedra of the lattice are alike and none is flat: dihedral angles are 60° and 90° (Labelle
and Shewchuk, "Isosurface Stuffing", SIGGRAPH 2007, 10.1145/1275808.1276448).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..core.recording_lock import recording_lock


@dataclass(frozen=True)
class Tetrahedra:
    """Tetrahedra with their corners."""

    points: NDArray[np.float64]
    """Corners [m], shape [N, 3]."""
    corners: NDArray[np.int32]
    """Four indices each, shape [T, 4], of positive volume."""


def lattice_tetrahedra(
    low: NDArray[np.float64], cells: NDArray[np.bool_], cell: float
) -> Tetrahedra:
    """Tetrahedra of the lattice that overlap marked cells.

    Args:
        low: Lowest corner of cell (0, 0, 0) [m], shape [3].
        cells: Whether each cubic cell is to be covered, shape [X, Y, Z].
        cell: Edge of a cell [m].

    Returns:
        Every tetrahedron that overlaps a marked cell. Each spans two neighboring cells: the
        centers of both and an edge of the face between them.
    """
    marked = np.pad(cells, 1)
    found = []
    for axis in range(3):
        step = np.eye(3, dtype=np.int64)[axis]
        first = np.argwhere(marked | np.roll(marked, -1, axis))
        first = first[first[:, axis] + 1 < marked.shape[axis]]
        second, third = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        ring = [second * 0, second, second + third, third]
        middle = 2 * first + 1
        for here, there in zip(ring, ring[1:] + ring[:1], strict=True):
            face = 2 * (first + step)
            found.append(
                np.stack([middle, middle + 2 * step, face + 2 * here, face + 2 * there], axis=1)
            )
    keys = np.concatenate(found)
    shape = 2 * np.array(marked.shape) + 3
    flat = np.ravel_multi_index(tuple(np.moveaxis(keys, 2, 0)), tuple(shape))
    used, corners = np.unique(flat, return_inverse=True)
    places = np.stack(np.unravel_index(used, tuple(shape)), axis=1)
    points = low + cell * (0.5 * places - 1.0)
    return Tetrahedra(points, corners.reshape(-1, 4).astype(np.int32))


def tetrahedron_volumes(
    points: NDArray[np.float64], corners: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Signed volumes [m³], shape [T]."""
    a, b, c, d = np.moveaxis(points[corners], 1, 0)
    return np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0


def tetrahedron_qualities(
    points: NDArray[np.float64], corners: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Mean ratio of each: 1 if regular, 0 if flat, negative if inverted, shape [T].

    Liu and Joe, "Relationship between tetrahedron shape measures", BIT 34, 1994,
    10.1007/BF01955874.
    """
    place = points[corners]
    squares = sum(
        ((place[:, i] - place[:, j]) ** 2).sum(axis=1) for i in range(4) for j in range(i)
    )
    volume = tetrahedron_volumes(points, corners)
    return np.sign(volume) * 12.0 * np.abs(3.0 * volume) ** (2.0 / 3.0) / squares


def barycentric_weights(
    points: NDArray[np.float64], place: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Barycentric coordinates of points, each in its own tetrahedron.

    Args:
        points: Points [m], shape [N, 3].
        place: Corners of the tetrahedra [m], shape [N, 4, 3].

    Returns:
        Coordinates, rows adding up to one, shape [N, 4].
    """
    edges = np.moveaxis(place[:, 1:] - place[:, :1], 1, 2)
    tail = np.linalg.solve(edges, (points - place[:, 0])[..., None])[..., 0]
    return np.column_stack([1.0 - tail.sum(axis=1), tail])


@wp.kernel(enable_backward=False)
def find_carriers(
    bounds: wp.uint64,
    margin: float,
    corner: wp.array2d[wp.vec3],
    group: wp.array[int],
    point: wp.array[wp.vec3],
    first_group: wp.array[int],
    second_group: wp.array[int],
    carrier: wp.array[int],
    inside: wp.array[float],
) -> None:
    """Find a tetrahedron of two groups around or near each point, preferring the first group."""
    i = wp.tid()
    x = point[i]
    reach = wp.vec3(margin, margin, margin)
    best = float(-1.0e6)
    found = int(-1)
    query = wp.bvh_query_aabb(bounds, x - reach, x + reach)
    t = int(0)
    while wp.bvh_query_next(query, t):
        if group[t] == first_group[i] or group[t] == second_group[i]:
            a = corner[t, 0]
            turn = wp.inverse(
                wp.matrix_from_cols(corner[t, 1] - a, corner[t, 2] - a, corner[t, 3] - a)
            )
            w = turn * (x - a)
            smallest = wp.min(wp.min(w[0], w[1]), wp.min(w[2], 1.0 - w[0] - w[1] - w[2]))
            # Depth inside a tetrahedron does not matter, so that the group decides.
            smallest = wp.min(smallest, 0.0)
            if group[t] == second_group[i]:
                smallest -= 0.02
            if smallest > best or (smallest == best and t < found):
                best = smallest
                found = t
    carrier[i] = found
    inside[i] = best


def carriers(
    points: NDArray[np.float64],
    tetrahedra: Tetrahedra,
    groups: NDArray[np.integer],
    wanted: NDArray[np.integer],
    margin: float,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Choose for each point the tetrahedron that carries it.

    Args:
        points: Points [m], shape [N, 3].
        tetrahedra: The tetrahedra to choose from.
        groups: Group of each tetrahedron, shape [T].
        wanted: The two groups that may carry each point, the preferred first, shape [N, 2].
        margin: How far outside a tetrahedron a point may be [m].

    Returns:
        Index of the tetrahedron, -1 if none is within the margin, shape [N]; and the smallest
        barycentric coordinate in it, at most zero, shape [N].
    """
    middle = points.mean(axis=0)
    place = (tetrahedra.points[tetrahedra.corners] - middle).astype(np.float32)
    with recording_lock:
        lower = wp.array(place.min(axis=1), dtype=wp.vec3, device="cpu")
        upper = wp.array(place.max(axis=1), dtype=wp.vec3, device="cpu")
        bounds = wp.Bvh(lower, upper)
        carrier = wp.empty(len(points), dtype=int, device="cpu")
        inside = wp.empty(len(points), dtype=float, device="cpu")
        wp.launch(
            find_carriers,
            dim=len(points),
            inputs=[
                bounds.id,
                margin,
                wp.array(place, dtype=wp.vec3, device="cpu"),
                wp.array(groups.astype(np.int32), dtype=int, device="cpu"),
                wp.array(points - middle, dtype=wp.vec3, device="cpu"),
                wp.array(np.ascontiguousarray(wanted[:, 0], np.int32), dtype=int, device="cpu"),
                wp.array(np.ascontiguousarray(wanted[:, 1], np.int32), dtype=int, device="cpu"),
                carrier,
                inside,
            ],
            device="cpu",
        )
        return carrier.numpy(), inside.numpy()
