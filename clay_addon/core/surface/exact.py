# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact surface of particle clay: a closed, colored triangle mesh with the right volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ....solver.core.errors import TactileClayError
from .particle_grid import ParticleGrid

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

# Lengths below are in units of the particle spacing d; volumes in d^3.
ISO_VALUE = 0.55
"""Level of the normalized density at which both a flat face and a crumb have nearly the right
volume, so that only a few hundredths of d remain to be corrected."""
KERNEL_SUPPORT = 2.0
CELL_SIZES = (0.35, 0.3337, 0.3681)
"""Sizes of marching-cubes cells; the later ones are tried only if a mesh fails its check."""
OFFSET_LIMITS = (-0.15, 0.3)
MIN_CAVITY = 8.0
"""Voids smaller than a cube of side 2 d are filled: they result from loose packing, are invisible,
and would trap resin in a print. Larger ones, as in a hollow model, are intended and stay."""
MIN_PIECE = 0.02
"""Smaller shells are collapsed voids, as a crumb of one particle has a volume of 1."""
MIN_EDGE = 1e-3
MAX_VOLUME_ERROR = 0.003
MAX_EXTENT = 1e5
COLOR_RADIUS = 1.5


class SurfaceError(TactileClayError, ValueError):
    """No valid surface can be made of the particles; the message says why."""


@dataclass(frozen=True)
class Surface:
    """A closed triangle mesh, wound outward; see `reconstruct`."""

    vertices: Floats
    """Vertex positions [m], shape [V, 3]."""
    faces: Indices
    """Vertex indices of the triangles, counter-clockwise seen from outside, shape [F, 3]."""
    colors: NDArray[np.float32] | None = None
    """Linear RGBA of the vertices, 0..1, shape [V, 4], or None."""
    velocities: NDArray[np.float32] | None = None
    """Velocities of the vertices, in the particles' unit, shape [V, 3], or None."""

    @property
    def volume(self) -> float:
        """Enclosed volume [m^3]."""
        center = self.vertices.mean(axis=0)
        return float(_face_volumes(self.vertices - center, self.faces).sum())

    @property
    def normals(self) -> Floats:
        """Unit normals of the vertices, area-weighted means over their faces, shape [V, 3]."""
        corners = self.vertices[self.faces]
        area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        return _vertex_normals(self.faces, area_vectors, len(self.vertices))

    def check(self) -> None:
        """Check that the mesh is closed, manifold and consistently wound.

        Raises:
            SurfaceError: It is not; the message counts the faults of each kind.
        """
        check_closed_manifold(self.faces, len(self.vertices))


def reconstruct(
    positions: ArrayLike,
    spacing: float,
    *,
    colors: ArrayLike | None = None,
    velocities: ArrayLike | None = None,
    smoothing: int = 20,
) -> Surface:
    """Reconstruct the surface of particle clay.

    The particle density is contoured and its bumps are smoothed away (Löschner et al. 2023,
    doi:10.2312/vmv.20231245, with the splashsurf library). Then every separate piece is offset
    along its normals until it has the volume of its own particles, one cube of side `spacing`
    each. Pieces too dense or too stretched for an offset of a third of the spacing are also scaled
    about their center. A color is a mean over the particles around a vertex; borders between
    colors are one or two spacings wide.

    Limitations: no feature smaller than about one spacing survives, and edges are rounded by half
    a spacing. A piece thinner than that may intersect itself after the offset. Voids smaller than
    a cube of two spacings are filled.

    Args:
        positions: Particle positions [m], shape [N, 3].
        spacing: Distance d between neighboring particles [m].
        colors: Linear RGBA of the particles, 0..1, shape [N, 4].
        velocities: Velocities of the particles in any unit, shape [N, 3].
        smoothing: Number of smoothing passes. More passes make the surface smoother and its edges
            rounder.

    Raises:
        SurfaceError: There are no particles, a position, color or velocity is not finite, shapes
            do not match, the spacing is not positive, `smoothing` is negative, the particles are
            spread too far, or no closed mesh could be made.
        ImportError: pysplashsurf is missing.
    """
    points, distance = _checked_positions(positions, spacing)
    tints = _checked_rows(colors, len(points), 4, "color")
    motion = _checked_rows(velocities, len(points), 3, "velocity")
    rows = [part for part in (tints, motion) if part is not None]
    if smoothing < 0:
        raise SurfaceError(f"The number of smoothing passes must not be negative, got {smoothing}.")
    origin = (points.min(axis=0) + points.max(axis=0)) / 2
    local = (points - origin) / distance
    if np.ptp(local, axis=0).max() > MAX_EXTENT:
        raise SurfaceError(
            f"The particles spread over {np.ptp(local, axis=0).max():.3g} spacings, more than the"
            f" {MAX_EXTENT:g} that a surface can cover. Has a piece flown off, or is the"
            f" spacing ({distance:g} m) in a different unit than the positions?"
        )
    fault: SurfaceError | None = None
    # Without smoothing last: coincident particles make a ball that smoothing would collapse.
    attempts = [(cell_size, smoothing) for cell_size in CELL_SIZES] + [(CELL_SIZES[0], 0)]
    for cell_size, passes in attempts:
        try:
            vertices, faces, carried = _reconstruct_local(
                local, np.concatenate(rows, axis=1) if rows else None, cell_size, passes
            )
        except SurfaceError as error:
            fault = error
            continue
        return Surface(
            vertices * distance + origin,
            faces,
            None if carried is None or tints is None else carried[:, :4],
            None if carried is None or motion is None else carried[:, -3:],
        )
    raise SurfaceError(
        f"No closed surface could be made of these {len(points)} particles: {fault}"
    ) from fault


def check_closed_manifold(faces: Indices, vertex_count: int) -> None:
    """Check that triangles form closed, manifold, consistently wound shells.

    Every edge must belong to exactly two triangles that traverse it in opposite directions, and
    the triangles around a vertex must form one fan.

    Args:
        faces: Vertex indices, shape [F, 3].
        vertex_count: Number of vertices.

    Raises:
        SurfaceError: They do not; the message counts the faults of each kind.
    """
    if len(faces) == 0:
        raise SurfaceError("the mesh is empty.")
    start = faces.ravel()
    end = np.roll(faces, -1, axis=1).ravel()
    order = np.argsort(start * vertex_count + end)
    keys = (start * vertex_count + end)[order]
    repeated = int((keys[1:] == keys[:-1]).sum())
    place = np.minimum(np.searchsorted(keys, end * vertex_count + start), len(keys) - 1)
    unpaired = int((keys[place] != end * vertex_count + start).sum())
    degenerate = int((start == end).sum())
    if repeated or unpaired or degenerate:
        raise SurfaceError(
            f"the mesh has {repeated} repeated edges, {unpaired} edges without a partner and"
            f" {degenerate} edges of zero length."
        )
    # Corner 3 f + k is at vertex faces[f, k]. Across an edge a -> b, the corners at a of both
    # triangles belong to the same fan; the other triangle's is the end of the half-edge b -> a.
    beyond = order[place]
    after = beyond - beyond % 3 + (beyond + 1) % 3
    fan = connected_components(len(start), np.arange(len(start)), after)
    fan_count = len(np.unique(fan))
    used = len(np.unique(start))
    if fan_count != used:
        raise SurfaceError(f"the mesh touches itself at {fan_count - used} vertices.")


def connected_components(count: int, start: Indices, end: Indices) -> Indices:
    """Label the connected components of an undirected graph.

    Args:
        count: Number of nodes.
        start: One end of every edge, shape [E].
        end: The other end, shape [E].

    Returns:
        For each node, the smallest node in its component, shape [count].
    """
    label = np.arange(count)
    while True:
        low = np.minimum(label[start], label[end])
        before = label.copy()
        np.minimum.at(label, label[start], low)
        np.minimum.at(label, label[end], low)
        while True:
            root = label[label]
            if np.array_equal(root, label):
                break
            label = root
        if np.array_equal(before, label):
            return label


def _checked_positions(positions: ArrayLike, spacing: float) -> tuple[Floats, float]:
    points = np.asarray(positions, dtype=np.float64)
    distance = float(spacing)
    if points.size == 0:
        raise SurfaceError("There are no particles, so there is no surface.")
    if points.ndim != 2 or points.shape[1] != 3:
        raise SurfaceError(f"Positions must have the shape (N, 3), not {points.shape}.")
    if not np.isfinite(distance) or distance <= 0:
        raise SurfaceError(f"The spacing must be a positive length, got {spacing}.")
    broken = int((~np.isfinite(points)).any(axis=1).sum())
    if broken:
        raise SurfaceError(
            f"{broken} of {len(points)} particles have positions that are not finite."
            " Go back to a frame where they were."
        )
    return points, distance


def _checked_rows(
    values: ArrayLike | None, particle_count: int, width: int, what: str
) -> NDArray[np.float32] | None:
    if values is None:
        return None
    rows = np.asarray(values, dtype=np.float32)
    if rows.shape != (particle_count, width):
        raise SurfaceError(
            f"Each particle needs one {what}: shape ({particle_count}, {width}), not {rows.shape}."
        )
    if not np.isfinite(rows).all():
        raise SurfaceError(f"Some particles have a {what} that is not finite.")
    return rows


def _reconstruct_local(
    points: Floats, values: NDArray[np.float32] | None, cell_size: float, smoothing: int
) -> tuple[Floats, Indices, NDArray[np.float32] | None]:
    """Make the volume-corrected mesh, its faces and the values at its vertices; lengths in d."""
    vertices, faces = _contour(points, cell_size, smoothing)
    check_closed_manifold(faces, len(vertices))
    grid = ParticleGrid(points, COLOR_RADIUS)
    solid, particle_count = _solids(vertices, faces, grid)
    kept = solid[faces[:, 0]] >= 0
    used, compact = np.unique(faces[kept], return_inverse=True)
    vertices, faces, solid = vertices[used], compact.reshape(-1, 3), solid[used]
    # Sample values before the volume correction, which moves vertices away from the particles.
    carried = None if values is None else grid.blend(vertices, values)
    vertices = _match_volumes(vertices, faces, solid, particle_count)
    shortest = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, -1, axis=1)], axis=2).min()
    if not shortest > MIN_EDGE:
        raise SurfaceError(f"the mesh has an edge of {shortest:.1e} spacings.")
    error = float(_face_volumes(vertices, faces).sum()) / len(points) - 1
    if not abs(error) < MAX_VOLUME_ERROR:
        raise SurfaceError(f"the mesh's volume differs from the particles' by {error:.1%}.")
    check_closed_manifold(faces, len(vertices))
    return vertices, faces, carried


def _contour(points: Floats, cell_size: float, smoothing: int) -> tuple[Floats, Indices]:
    import pysplashsurf

    # The library's unit is the particle radius, half of d.
    try:
        mesh, _ = pysplashsurf.reconstruction_pipeline(
            points,
            particle_radius=0.5,
            rest_density=1.0,
            smoothing_length=KERNEL_SUPPORT,
            cube_size=2 * cell_size,
            iso_surface_threshold=ISO_VALUE,
            mesh_smoothing_iters=smoothing,
            mesh_smoothing_weights=smoothing > 0,
            mesh_cleanup=True,
            decimate_barnacles=True,
        )
    except RuntimeError as error:
        raise SurfaceError(f"the contour failed ({str(error).splitlines()[0]}).") from error
    triangles: Any = mesh.mesh if isinstance(mesh, pysplashsurf.MeshWithData) else mesh
    return np.array(triangles.vertices), np.array(triangles.triangles).astype(np.int64)


def _solids(vertices: Floats, faces: Indices, grid: ParticleGrid) -> tuple[Indices, Floats]:
    """Group the shells into pieces of clay, and count the particles of each.

    A piece is an outer shell with the cavities inside it. Cavities smaller than `MIN_CAVITY` and
    shells without particles are dropped.

    Returns:
        The piece of every vertex or -1, shape [V], and the particle count of every piece, shape
        [P].
    """
    component = connected_components(len(vertices), faces.ravel(), np.roll(faces, -1, 1).ravel())
    shells, shell = np.unique(component, return_inverse=True)
    volumes = np.bincount(shell[faces[:, 0]], _face_volumes(vertices, faces), minlength=len(shells))
    outer = volumes > MIN_PIECE
    if not outer.any():
        raise SurfaceError("no shell encloses a volume.")
    if len(shells) == 1:
        return shell, np.array([float(grid.particle_count)])
    piece = np.where(outer, np.arange(len(shells)), -1)
    home = piece.copy()
    for void in np.flatnonzero(~outer).tolist():
        home[void] = _enclosing_shell(vertices, faces, shell, np.where(outer, volumes, 0), void)
        piece[void] = home[void] if volumes[void] < -MIN_CAVITY else -1
    largest = int(volumes.argmax())
    of_particle = np.full(grid.particle_count, -1)
    nearest = grid.nearest(vertices)
    seen = (nearest >= 0) & (home[shell] >= 0)
    of_particle[nearest[seen]] = home[shell[seen]]
    of_particle = grid.spread(of_particle)
    of_particle[of_particle < 0] = largest
    particle_count = np.bincount(of_particle, minlength=len(shells)).astype(np.float64)
    piece[(piece >= 0) & (particle_count[piece] == 0)] = -1
    numbers, dense = np.unique(piece[piece >= 0], return_inverse=True)
    piece[piece >= 0] = dense
    return piece[shell], particle_count[numbers]


def _enclosing_shell(
    vertices: Floats, faces: Indices, shell: Indices, volumes: Floats, void: int
) -> int:
    """The smallest shell with positive volume that encloses a void, or -1."""
    probe = vertices[np.flatnonzero(shell == void)[0]]
    a, b, c = (vertices[faces[:, k]] - probe for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    determinant = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = (
        la * lb * lc
        + np.einsum("ij,ij->i", a, b) * lc
        + np.einsum("ij,ij->i", b, c) * la
        + np.einsum("ij,ij->i", c, a) * lb
    )
    solid_angle = 2 * np.arctan2(determinant, denominator)
    winding = np.bincount(shell[faces[:, 0]], solid_angle, minlength=len(volumes)) / (4 * np.pi)
    around = np.flatnonzero((winding > 0.5) & (volumes > 0))
    return int(around[volumes[around].argmin()]) if len(around) else -1


def _face_volumes(vertices: Floats, faces: Indices) -> Floats:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volumes: Floats = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    return volumes


def _match_volumes(vertices: Floats, faces: Indices, solid: Indices, target: Floats) -> Floats:
    """Offset, then scale, every piece so that it has its target volume."""
    count = len(target)
    of_face = solid[faces[:, 0]]
    middle = (
        np.stack([np.bincount(solid, vertices[:, k], minlength=count) for k in range(3)], axis=1)
        / np.bincount(solid, minlength=count)[:, None]
    )
    start = vertices - middle[solid]
    vertices = start.copy()
    offset = np.zeros(count)
    for _ in range(4):
        corners = vertices[faces]
        area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        area = np.bincount(of_face, np.linalg.norm(area_vectors, axis=1), minlength=count)
        volume = np.bincount(of_face, _face_volumes(vertices, faces), minlength=count)
        wanted = np.clip(offset + (target - volume) / area, *OFFSET_LIMITS)
        vertices += (wanted - offset)[solid][:, None] * _vertex_normals(
            faces, area_vectors, len(vertices)
        )
        offset = wanted
    volume = np.bincount(of_face, _face_volumes(vertices, faces), minlength=count)
    # Films between stretched particles are thinner than the offset and would turn inside out.
    spoiled = volume < target / 2
    vertices = np.where(spoiled[solid][:, None], start, vertices)
    volume = np.bincount(of_face, _face_volumes(vertices, faces), minlength=count)
    scale = np.cbrt(target / volume)
    return vertices * scale[solid][:, None] + middle[solid]


def _vertex_normals(faces: Indices, area_vectors: Floats, vertex_count: int) -> Floats:
    normals = np.empty((vertex_count, 3))
    for axis in range(3):
        normals[:, axis] = np.bincount(
            faces.ravel(), np.repeat(area_vectors[:, axis], 3), minlength=vertex_count
        )
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.maximum(length, 1e-30)
