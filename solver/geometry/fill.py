# SPDX-License-Identifier: GPL-3.0-or-later
"""Filling a closed mesh with particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from ..core.recording_lock import recording_lock
from .closed_mesh import ClosedMesh, MeshError, closed_mesh
from .columns import cross_columns, union_volume
from .shells import shell_volumes
from .thickness import MIN_THICKNESS, layer_in_thin_walls, wall_thickness

MAX_PARTICLES = 20_000_000
"""More than this is treated as a mistake in units."""

_SAMPLING = 0.3
"""Distance at which the volume of overlapping bodies is sampled, in spacings."""
_TOUCHING = 1e-4
"""Points closer to the surface than this are on it, in spacings."""
_THIN_SHARE = 0.02
"""Fraction of the surface that may have thin walls without a note."""
_ALL_THIN = 0.5
"""Fraction of the surface with thin walls above which the mesh counts as a sheet."""
_NEIGHBORS = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])


class ThinWallsError(MeshError):
    """A mesh is a sheet thinner than the particle spacing."""


@wp.kernel(enable_backward=False)
def measure_distance(
    mesh: wp.uint64, point: wp.array[wp.vec3], max_distance: float, distance: wp.array[float]
) -> None:
    """Measure the distance to the mesh, at most ``max_distance``."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, point[i], max_distance)
    if query.result:
        nearest = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = wp.length(point[i] - nearest)
    else:
        distance[i] = max_distance


@dataclass(frozen=True, eq=False)
class Filling:
    """Particles that fill a mesh, with notes for the user."""

    points: NDArray[np.float32]
    """Particle positions [m], shape [N, 3]."""
    mesh: ClosedMesh
    """The mesh that was filled."""
    notes: tuple[str, ...]
    """What was changed in the mesh, and what is imperfect, as sentences."""


def fill_mesh(vertices: ArrayLike, faces: ArrayLike, spacing: float) -> NDArray[np.float32]:
    """Place particles on a cubic lattice inside a closed mesh.

    Their number is round(volume / spacing³), the mesh's volume to within half a particle: where
    the lattice cuts the surface, the deepest points are kept. Of the lattice's eight half-cell
    offsets, the one whose point count is closest to that number is used.

    Args:
        vertices: Corner positions [m], shape [V, 3].
        faces: Triangles, shape [F, 3], cleaned up by `closed_mesh`. Concave shapes, cavities and
            several bodies are fine; bodies that overlap are united.
        spacing: Lattice spacing [m].

    Returns:
        Particle positions [m], shape [N, 3], ordered along x, then y, then z.

    Raises:
        MeshError: The mesh is not usable (see `closed_mesh`), or is too small, too thin or far too
            large for the spacing.
        ValueError: The spacing is not a positive number.
    """
    return fill(closed_mesh(vertices, faces), spacing).points


def fill(
    mesh: ClosedMesh, spacing: float, *, name: str = "The mesh", follow_thin_walls: bool = False
) -> Filling:
    """Place particles as `fill_mesh` does, and return notes for the user.

    Args:
        mesh: The mesh to fill.
        spacing: Lattice spacing [m].
        name: Name of the mesh in error messages.
        follow_thin_walls: Whether walls too thin for the lattice get one layer of particles in
            their middle, which makes them thicker, instead of an error or a note.

    Raises:
        ThinWallsError: The mesh is a sheet that is too thin for the spacing.
        MeshError: The mesh is too small or far too large for the spacing.
        ValueError: The spacing is not a positive number.
    """
    if not (np.isfinite(spacing) and spacing > 0):
        raise ValueError(f"The particle spacing is {spacing!r} m; it must be above 0.")
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    volume = float(shell_volumes(mesh.vertices, mesh.faces, mesh.shell).sum()) / spacing**3
    if volume > 2.0 * MAX_PARTICLES:
        raise MeshError(
            f"{name} is {max(high - low):.3g} m long and would need far too many particles at a "
            f"spacing of {spacing:.3g} m; check its units or use a larger spacing."
        )
    center = 0.5 * (low + high)
    local = (mesh.vertices - center) / spacing
    with recording_lock:
        surface = wp.Mesh(
            points=wp.array(local.astype(np.float32), dtype=wp.vec3, device="cpu"),
            indices=wp.array(mesh.faces.ravel(), dtype=int, device="cpu"),
        )
    united = union_volume(local, mesh.faces, volume, _SAMPLING)
    target = round(united)
    if float(max(high - low)) < spacing:
        raise MeshError(
            f"{name} is too small for a particle spacing of {spacing:.3g} m: it holds no "
            f"particle. Use a spacing below {0.5 * float(min(high - low)):.2g} m or a larger mesh."
        )
    thickness = wall_thickness(surface, local, mesh.faces)
    thin = thickness.share_below(MIN_THICKNESS)
    # Where bodies overlap, rays hit walls inside other bodies.
    is_thin = thin > _THIN_SHARE and united == volume
    notes = list(mesh.notes)
    if is_thin:
        wall = 1e3 * spacing * thickness.median_below(MIN_THICKNESS)
        text = (
            f"walls about {wall:.2g} mm thick, too thin for a particle spacing of "
            f"{1e3 * spacing:.3g} mm"
        )
        if follow_thin_walls:
            notes.append(
                f"One layer of particles follows {text}; they become {1e3 * spacing:.3g} mm thick."
            )
        elif thin > _ALL_THIN:
            raise ThinWallsError(
                f"{name} has {text}. Use a spacing of at most {_rounded(wall):g} mm, make it "
                "thicker, or fill it with one layer of particles (Thin Walls)."
            )
        else:
            notes.append(f"{thin:.0%} of the surface has {text}: particles are missing there.")
    if target == 0 and not (is_thin and follow_thin_walls):
        raise MeshError(
            f"{name} holds no particle at a spacing of {spacing:.3g} m. Use a spacing below "
            f"{0.5 * float(min(high - low)):.2g} m or a larger mesh."
        )
    lattice = np.zeros((0, 3))
    if not (is_thin and follow_thin_walls and thin > _ALL_THIN):
        lattices = (_LatticeFilling(surface, local, mesh.faces, s) for s in np.ndindex(2, 2, 2))
        lattice = min(lattices, key=lambda one: abs(one.count - target)).points(target)
    if is_thin and follow_thin_walls:
        lattice = np.concatenate(
            [lattice, layer_in_thin_walls(surface, local, mesh.faces, lattice)]
        )
    points = (lattice * spacing + center).astype(np.float32)
    return Filling(points, mesh, tuple(notes))


class _LatticeFilling:
    """The points of a lattice that lie inside a mesh, in units of the spacing.

    Args:
        surface: The mesh, for distance queries.
        vertices: Its corners, centered on the origin, shape [V, 3].
        faces: Corner indices, shape [F, 3].
        shift: For each axis, 1 to shift the lattice by half a cell, else 0.
    """

    def __init__(
        self,
        surface: wp.Mesh,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        shift: tuple[int, ...],
    ) -> None:
        self._surface = surface
        reach = np.ceil(np.abs(vertices).max(0)).astype(np.int64) + 2
        self._shape = 2 * reach + 1
        self._origin = 0.5 * np.array(shift) - reach
        xs, ys = (self._origin[axis] + np.arange(self._shape[axis]) for axis in range(2))
        line, bottom, top = cross_columns(vertices, faces, xs, ys).intervals()
        first = np.ceil(bottom - self._origin[2]).astype(np.int64)
        count = np.maximum(np.floor(top - self._origin[2]).astype(np.int64) - first + 1, 0)
        step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        inside = np.repeat(line * self._shape[2] + first, count) + step
        # Points with a neighbor outside are close to the surface; the others need no distance.
        rim = np.zeros(len(inside), bool)
        for offset in _NEIGHBORS:
            rim |= ~_contains(inside, inside + self._step(offset))
        depth = self._distance(inside[rim])
        on_surface = np.zeros(len(inside), bool)
        on_surface[rim] = depth < _TOUCHING
        self._inside = inside[~on_surface]
        self._rim = inside[rim][depth >= _TOUCHING]
        self._depth = depth[depth >= _TOUCHING]

    @property
    def count(self) -> int:
        """Number of points inside."""
        return len(self._inside)

    def _step(self, offset: NDArray[np.int64]) -> int:
        """Change of a cell's flat index along an offset."""
        return int((offset[0] * self._shape[1] + offset[1]) * self._shape[2] + offset[2])

    def _place(self, cell: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.stack(np.unravel_index(cell, self._shape), 1) + self._origin

    def _distance(self, cell: NDArray[np.int64]) -> NDArray[np.float64]:
        """Distance of cells from the surface, rounded so that equal ones compare equal."""
        with recording_lock:
            point = wp.array(self._place(cell).astype(np.float32), dtype=wp.vec3, device="cpu")
            distance = wp.empty(len(cell), dtype=float, device="cpu")
            wp.launch(
                measure_distance,
                dim=len(cell),
                inputs=[self._surface.id, point, 3.0, distance],
                device="cpu",
            )
        return np.round(distance.numpy().astype(np.float64), 4)

    def points(self, target: int) -> NDArray[np.float64]:
        """A given number of points: the deepest inside, then the nearest outside; [N, 3]."""
        cells = self._inside
        surplus = self.count - target
        if surplus > 0:
            shallow = self._rim[np.argsort(self._depth, kind="stable")[:surplus]]
            cells = np.setdiff1d(cells, shallow, assume_unique=True)
        while len(cells) < target:
            around = np.unique(
                np.concatenate([cells + self._step(offset) for offset in _NEIGHBORS])
            )
            around = around[~_contains(cells, around)]
            near = np.argsort(self._distance(around), kind="stable")[: target - len(cells)]
            cells = np.union1d(cells, around[near])
        return self._place(cells)


def _contains(ordered: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each wanted number is in a sorted array, shape [W]."""
    if not len(ordered):
        return np.zeros(len(wanted), bool)
    place = np.minimum(np.searchsorted(ordered, wanted), len(ordered) - 1)
    return np.asarray(ordered[place] == wanted)


def _rounded(millimeters: float) -> float:
    """Round down to two significant digits."""
    step = 10.0 ** (np.floor(np.log10(millimeters)) - 1)
    return float(np.floor(millimeters / step + 1e-6) * step)
