# SPDX-License-Identifier: GPL-3.0-or-later
"""Wall thickness of a closed mesh, and particles in walls too thin for a lattice."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..core.recording_lock import recording_lock
from .closed_mesh import mesh_area

MIN_THICKNESS = 0.9
"""Walls thinner than this cannot be filled by a lattice without holes, in spacings."""

_LAYER_DISTANCE = 0.79
"""Smallest distance in a layer, in spacings, which yields one particle per spacing²."""
_LAYER_SAMPLES = 12.0
"""Number of darts per particle of a layer."""
_SAMPLE_COUNT = 4000
_START = 1e-4
"""How far inside the surface a ray starts, relative to the mesh's size."""


@wp.kernel(enable_backward=False)
def measure_ray(
    mesh: wp.uint64,
    start: wp.array[wp.vec3],
    direction: wp.array[wp.vec3],
    max_distance: float,
    distance: wp.array[float],
) -> None:
    """Measure the distance along a ray to the mesh, at most ``max_distance``."""
    i = wp.tid()
    query = wp.mesh_query_ray(mesh, start[i], direction[i], max_distance)
    distance[i] = max_distance
    if query.result:
        distance[i] = query.t


@dataclass(frozen=True, eq=False)
class Thickness:
    """Wall thickness at points spread evenly over a surface."""

    values: NDArray[np.float64]
    """Distance straight through the wall; each sample covers the same area, shape [S]."""
    points: NDArray[np.float64]
    """Points halfway between the two sides, shape [S, 3]."""

    def share_below(self, thickness: float) -> float:
        """Fraction of the surface with walls thinner than a threshold."""
        return float((self.values < thickness).mean())

    def median_below(self, thickness: float) -> float:
        """Median thickness of the walls thinner than a threshold."""
        return float(np.median(self.values[self.values < thickness]))


def wall_thickness(
    surface: wp.Mesh,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    *,
    count: int = _SAMPLE_COUNT,
) -> Thickness:
    """Measure wall thickness with rays.

    Args:
        surface: The mesh, for ray queries.
        vertices: Its corners, shape [V, 3].
        faces: Corner indices, wound outward, shape [F, 3].
        count: Number of samples.
    """
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    random = np.random.default_rng(0)
    # Stratified rather than independent: each part of the surface gets samples by its area.
    ends = np.cumsum(area)
    face = np.searchsorted(ends, (np.arange(count) + random.uniform(size=count)) / count * ends[-1])
    face = np.minimum(face, len(faces) - 1)
    one, two = random.uniform(size=(2, count))
    fold = one + two > 1.0
    one, two = np.where(fold, 1.0 - one, one), np.where(fold, 1.0 - two, two)
    a, b, c = np.moveaxis(corners[face], 1, 0)
    inward = -normal[face] / np.maximum(area[face], 1e-300)[:, None]
    size = float(np.ptp(vertices, axis=0).max())
    start = a + one[:, None] * (b - a) + two[:, None] * (c - a) + _START * size * inward
    with recording_lock:
        distance = wp.empty(count, dtype=float, device="cpu")
        wp.launch(
            measure_ray,
            dim=count,
            inputs=[
                surface.id,
                wp.array(start.astype(np.float32), dtype=wp.vec3, device="cpu"),
                wp.array(inward.astype(np.float32), dtype=wp.vec3, device="cpu"),
                2.0 * size,
                distance,
            ],
            device="cpu",
        )
    through = distance.numpy().astype(np.float64)
    return Thickness(through + _START * size, start + 0.5 * through[:, None] * inward)


def layer_in_thin_walls(
    surface: wp.Mesh,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    present: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Place one layer of particles halfway through walls too thin for a lattice, shape [L, 3].

    Poisson-disk sampling by dart throwing (Cook, 10.1145/8927.8927): darts that land too close to
    another or to an existing particle are rejected.

    Args:
        surface: The mesh, for ray queries, in units of the spacing.
        vertices: Its corners, shape [V, 3].
        faces: Corner indices, wound outward, shape [F, 3].
        present: Existing particles, shape [N, 3].
    """
    walls = wall_thickness(
        surface, vertices, faces, count=math.ceil(_LAYER_SAMPLES * mesh_area(vertices, faces))
    )
    darts = walls.points[walls.values < MIN_THICKNESS]
    darts = np.random.default_rng(1).permutation(darts)
    taken: dict[tuple[int, ...], list[NDArray[np.float64]]] = {}
    for point in present:
        taken.setdefault(tuple(np.floor(point).astype(int)), []).append(point)
    layer = []
    around = list(np.ndindex(3, 3, 3))
    for dart in darts:
        cell = np.floor(dart).astype(int) - 1
        near = [p for o in around for p in taken.get(tuple(cell + o), ())]
        if near and float(((np.array(near) - dart) ** 2).sum(1).min()) < _LAYER_DISTANCE**2:
            continue
        layer.append(dart)
        taken.setdefault(tuple(cell + 1), []).append(dart)
    return np.array(layer).reshape(-1, 3)
