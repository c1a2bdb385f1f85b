# SPDX-License-Identifier: GPL-3.0-or-later
"""Filling a closed mesh with particles."""

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..core.recording_lock import recording_lock
from .closed_mesh import MeshError, check_closed_mesh, group_count, mesh_volume

MOST_PARTICLES = 20_000_000
"""More than this is taken for a mistake in units."""

_CHUNK = 2_000_000
_SAMPLING = 0.4
"""Distance at which the volume of overlapping bodies is sampled, in spacings."""
_SAMPLING_ERROR = 0.03
"""How far sampling can be off: bodies that differ by less are taken not to overlap."""


@wp.kernel(enable_backward=False)
def measure_depth(
    mesh: wp.uint64, point: wp.array[wp.vec3], farthest: float, depth: wp.array[float]
) -> None:
    """Signed distance to the mesh, positive inside [m]."""
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, point[i], farthest)
    if query.result:
        nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        depth[i] = -query.sign * wp.length(point[i] - nearest)
    else:
        depth[i] = -farthest


def fill_mesh(vertices: ArrayLike, faces: ArrayLike, spacing: float) -> NDArray[np.float32]:
    """Place particles on a cubic lattice inside a closed mesh.

    Their number is round(volume / spacing³), so that particles times spacing³ is the mesh's
    volume to half a particle: where the lattice cuts the surface, the deepest points win. Of the
    lattice's eight half-cell offsets the one is taken whose own count comes nearest.

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Triangles, shape [F, 3]; concave shapes and several bodies are fine.
        spacing: Lattice spacing [m].

    Returns:
        Particle positions [m], shape [N, 3], ordered along x, then y, then z.

    Raises:
        MeshError: The mesh is open (the message names the number of holes), encloses no volume,
            has coordinates that are not finite, or is too small or far too large for the spacing.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise ValueError(f"The particle spacing is {spacing!r} m; it must be above 0.")
    points, triangles = check_closed_mesh(vertices, faces)
    low, high = points.min(0), points.max(0)
    cells = (high - low) / spacing
    if np.prod(cells + 2.0) > 10.0 * MOST_PARTICLES:
        raise MeshError(
            f"The mesh is {max(high - low):.3g} m long and would take far too many particles at a "
            f"spacing of {spacing:.3g} m; check its units or use a larger spacing."
        )
    center = 0.5 * (low + high)
    local = ((points - center) / spacing).astype(np.float32)
    with recording_lock:
        mesh = wp.Mesh(
            points=wp.array(local, dtype=wp.vec3, device="cpu"),
            indices=wp.array(triangles.ravel(), dtype=int, device="cpu"),
            support_winding_number=True,
        )
    target = _particle_target(mesh, local, triangles)
    if target == 0:
        smallest = float(min(high - low))
        raise MeshError(
            f"The mesh is too small for a particle spacing of {spacing:.3g} m: it holds no "
            f"particle. Use a spacing below {0.5 * smallest:.2g} m or a larger mesh."
        )
    best: tuple[int, NDArray[np.float64], NDArray[np.float32]] | None = None
    for shift in np.ndindex(2, 2, 2):
        lattice = _lattice(cells, np.array(shift))
        depth = _depths(mesh, lattice, float(np.linalg.norm(cells)) + 1.0)
        miss = abs(int((depth > 0.0).sum()) - target)
        if best is None or miss < best[0]:
            best = (miss, lattice, depth)
    assert best is not None
    _, lattice, depth = best
    if len(lattice) < target:
        raise MeshError(
            f"The mesh is too thin for a particle spacing of {spacing:.3g} m; use a smaller one."
        )
    # Rounding keeps points that are equally deep in lattice order, whatever the last bits say.
    deepest = np.sort(np.argsort(-np.round(depth, 4), kind="stable")[:target])
    return (lattice[deepest] * spacing + center).astype(np.float32)


def _particle_target(
    mesh: wp.Mesh, local: NDArray[np.float32], triangles: NDArray[np.int32]
) -> int:
    """Volume in units of spacing³; where bodies overlap, the overlap counts once."""
    volume = mesh_volume(local, triangles)
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    if group_count(edges) == 1:
        return round(volume)
    extent = np.ptp(local, axis=0).astype(np.float64)
    # One sample anywhere in each cell: a plain grid would count the flat sides of boxes wrong.
    samples = _lattice(extent / _SAMPLING, np.zeros(3, np.int64))
    samples = (samples + np.random.default_rng(0).uniform(-0.5, 0.5, samples.shape)) * _SAMPLING
    depth = _depths(mesh, samples, float(np.linalg.norm(extent)) + 1.0)
    filled = float((depth > 0.0).sum()) * _SAMPLING**3
    return round(volume if abs(filled - volume) < _SAMPLING_ERROR * volume else filled)


def _lattice(cells: NDArray[np.float64], shift: NDArray[np.int64]) -> NDArray[np.float64]:
    """Lattice points around the origin in units of the spacing, one layer past the mesh."""
    axes = []
    for extent, half in zip(cells, shift, strict=True):
        reach = int(np.ceil(0.5 * extent)) + 1
        axes.append(np.arange(-reach, reach + 1) + 0.5 * half)
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def _depths(mesh: wp.Mesh, lattice: NDArray[np.float64], farthest: float) -> NDArray[np.float32]:
    parts = []
    for start in range(0, len(lattice), _CHUNK):
        part = lattice[start : start + _CHUNK]
        with recording_lock:
            depth = wp.empty(len(part), dtype=float, device="cpu")
            wp.launch(
                measure_depth,
                dim=len(part),
                inputs=[mesh.id, wp.array(part, dtype=wp.vec3, device="cpu"), farthest, depth],
                device="cpu",
            )
        parts.append(depth.numpy())
    return np.concatenate(parts)
