# SPDX-License-Identifier: GPL-3.0-or-later
"""A smooth surface of particle clay, fast enough for live sculpting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from .....solver.geometry.surface_net import one_sheet
from ..exact import SurfaceError
from . import field as quick_surface_field
from . import finish as quick_surface_finish
from . import net as quick_surface_net
from .field import NODES, THIN_DENSITY, Blocks, blur, find_blocks, splat_mass
from .finish import paint_vertices, smooth
from .net import Net, cut_cells, join_vertices

# Lengths below are in units of the particle spacing.
CELL_SIZE = 0.5
"""Side of a cell of the grid."""
SMOOTHING = 12
"""Number of passes that smooth out the particles."""
MAX_SMOOTHING_DISTANCE = 0.12
"""Smoothing moves no vertex farther than this, so that crumbs do not vanish."""
COLOR_SMOOTHING = 2
"""Number of passes that soften borders between colors."""
STILL = 0.005
"""The surface is kept while no particle has moved farther than this along any axis."""
MAX_BLOCK_COUNT = 1 << 16
"""Maximum number of blocks, half a gigabyte: enough for two million particles in one piece, or six
thousand scattered ones."""


@dataclass(frozen=True)
class QuadSurface:
    """A closed mesh of quads, wound outward; see `QuickSurface`."""

    vertices: NDArray[np.float32]
    """Vertex positions, shape [V, 3]."""
    faces: NDArray[np.int32]
    """Vertex indices of the quads, counter-clockwise seen from outside, shape [F, 4]."""
    colors: NDArray[np.float32]
    """Linear RGBA of the vertices, shape [V, 4]."""
    edges: NDArray[np.int32]
    """Vertex indices at both ends of each edge, shape [E, 2]."""
    face_edges: NDArray[np.int32]
    """Edge from each corner of a quad to the next, shape [F, 4]."""

    @property
    def triangles(self) -> NDArray[np.int64]:
        """The quads split into triangles, shape [2 F, 3]."""
        return self.faces[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int64)


class QuickSurface:
    """Makes the surface of clay, frame after frame, in a few milliseconds each.

    The particle density, smoothed over three quarters of a spacing, is contoured by a net of quads
    (Gibson 1998, doi:10.1007/BFb0056277), and remaining bumps are smoothed away. The contour is at
    half the interior density, where flat faces belong, so no offset is needed. Particles of thin
    parts, where the density is too low, get more weight. Everything runs on one CPU thread, and
    other Python threads can run meanwhile.

        quick = QuickSurface(spacing=0.005)
        surface = quick.reconstruct(positions, colors)

    Limitations: blocks lose 2 to 3 % of their volume at rounded edges; sheets of one layer are up
    to a third too thick, and the volume of small crumbs is off by up to a third. Parts closer than
    about one spacing merge. `exact.reconstruct` is exact.

    Args:
        spacing: Distance between neighboring particles, in the unit of the positions.

    Raises:
        SurfaceError: The spacing is not a positive length.
    """

    def __init__(self, spacing: float) -> None:
        self.spacing = float(spacing)
        if not (np.isfinite(self.spacing) and self.spacing > 0):
            raise SurfaceError(f"The spacing must be a positive length, got {spacing}.")
        self._made: tuple[NDArray[np.float32], NDArray[np.float32], QuadSurface] | None = None
        self._blocks, self._net = Blocks(), Net()
        self._net.one_sheet = wp.array(one_sheet().astype(np.uint8), device="cpu")
        self._net.count = _zeros(4)
        self._blocks.count = _zeros(1)
        self._blocks.particle_block = _zeros(0)
        self._make_blocks(256)
        self._make_net(0, 0)

    def reconstruct(self, positions: ArrayLike, colors: ArrayLike) -> QuadSurface:
        """Make the surface of the clay.

        Args:
            positions: Particle positions, shape [N, 3]; those that are not finite are ignored.
            colors: Linear RGBA of the particles, 0..1, shape [N, 4]; likewise.

        Returns:
            The surface; the same object as before while nothing has moved. It shares no arrays.

        Raises:
            SurfaceError: Shapes do not match, or the particles are scattered too widely.
        """
        points = np.ascontiguousarray(positions, np.float32)
        tints = np.ascontiguousarray(colors, np.float32)
        if points.ndim != 2 or points.shape[1] != 3:
            raise SurfaceError(f"Positions must have the shape (N, 3), not {points.shape}.")
        if tints.shape != (len(points), 4):
            raise SurfaceError(f"Colors must have the shape ({len(points)}, 4), not {tints.shape}.")
        if self._made is None or not self._is_still(points, tints, *self._made[:2]):
            self._made = points.copy(), tints.copy(), self._reconstruct(points, tints)
        return self._made[2]

    def _is_still(
        self,
        points: NDArray[np.float32],
        tints: NDArray[np.float32],
        points_before: NDArray[np.float32],
        tints_before: NDArray[np.float32],
    ) -> bool:
        if points.shape != points_before.shape or not np.array_equal(tints, tints_before):
            return False
        moved = np.abs(points - points_before)
        return bool((moved <= STILL * self.spacing).all())

    def _reconstruct(self, points: NDArray[np.float32], tints: NDArray[np.float32]) -> QuadSurface:
        blocks, net = self._blocks, self._net
        # Volume of a particle [cells], and cells per unit of length.
        filled, inverse = CELL_SIZE**-3, 1.0 / (CELL_SIZE * self.spacing)
        position = wp.array(points, dtype=wp.vec3, device="cpu", copy=False)
        color = wp.array(tints, dtype=wp.vec4, device="cpu", copy=False)
        particle_count = len(points)
        if particle_count > len(blocks.particle_block):
            blocks.particle_block = _zeros(particle_count)
        _launch(find_blocks, particle_count, position, inverse, blocks)
        while (block_count := int(blocks.count.numpy()[0])) > len(blocks.place):
            self._make_blocks(2 * len(blocks.place))
            _launch(find_blocks, particle_count, position, inverse, blocks)
        for thin in (0.0, THIN_DENSITY):
            _launch(splat_mass, particle_count, position, inverse, filled, thin, blocks)
            for axis, source, target in (
                (0, blocks.mass, blocks.scratch),
                (1, blocks.scratch, blocks.mass),
                (2, blocks.mass, blocks.density),
            ):
                _launch(blur, axis, source, target, blocks, dim=block_count)
        _launch(cut_cells, blocks, net)
        vertex_count, painted_count = net.count.numpy()[:2].tolist()
        if vertex_count > len(net.cell) or painted_count >= len(net.paint):
            self._make_net(vertex_count * 4 // 3, painted_count * 4 // 3)
        origin = blocks.place.numpy()[1].tolist() if block_count > 1 else (0, 0, 0)
        _launch(join_vertices, wp.vec3i(*origin), blocks, net)
        _launch(paint_vertices, particle_count, position, color, inverse, blocks, net)
        _launch(smooth, SMOOTHING, MAX_SMOOTHING_DISTANCE / CELL_SIZE, net.position, net)
        _launch(smooth, COLOR_SMOOTHING, 0.0, net.color, net)
        edge_count, quad_count = net.count.numpy()[2:].tolist()
        corner = 8.0 * np.array(origin, np.float64)
        at = net.position.numpy()[:vertex_count, :3] + corner
        return QuadSurface(
            (at / inverse).astype(np.float32),
            net.quad.numpy()[:quad_count].copy(),
            net.color.numpy()[:vertex_count].copy(),
            net.edge.numpy()[:edge_count].copy(),
            net.quad_edge.numpy()[:quad_count].copy(),
        )

    def _make_blocks(self, room: int) -> None:
        if room > MAX_BLOCK_COUNT:
            raise SurfaceError(
                "The particles are scattered too widely for a live surface, or the spacing"
                f" ({self.spacing:g}) is in another unit than their positions."
            )
        blocks, net = self._blocks, self._net
        slots = 4 * room
        blocks.slot_key = _zeros(slots, wp.int64)
        blocks.slot_block = _zeros(slots)
        blocks.place = _zeros(room, wp.vec3i)
        blocks.reached = _zeros(room)
        blocks.neighbor = _zeros((room, 27))
        for name in ("mass", "scratch", "density"):
            setattr(blocks, name, _zeros((room, NODES), float))
        for name in ("lowest", "highest"):
            setattr(blocks, name, _zeros(room, float))
        net.cut = _zeros((room, NODES // 8), wp.uint8)
        net.painted = _zeros(room)
        net.shows = _zeros(room, wp.uint8)
        net.vertex = _zeros((room, NODES))

    def _make_net(self, vertices: int, painted: int) -> None:
        net = self._net
        net.cell = _zeros(vertices)
        net.pattern = _zeros(vertices, wp.uint8)
        net.neighbor = _zeros((vertices, 6))
        net.edge_of = _zeros((vertices, 3))
        # A vertex adds at most one edge and one quad per axis.
        net.edge = _zeros((3 * vertices, 2))
        for name in ("quad", "quad_edge"):
            setattr(net, name, _zeros((3 * vertices, 4)))
        for name in ("position", "color", "kept"):
            setattr(net, name, _zeros(vertices, wp.vec4))
        net.scratch = _zeros((2, vertices), wp.vec4)
        # Painted blocks are numbered from 1.
        net.paint = _zeros((painted + 1, NODES), wp.vec4)


def load_kernels() -> None:
    """Compile or load the kernels: seconds the first time on a machine, then milliseconds.

    No other thread may load kernels at the same time.
    """
    for module in (quick_surface_field, quick_surface_net, quick_surface_finish):
        wp.load_module(module, device="cpu")


def _zeros(shape: Any, dtype: Any = int) -> Any:
    return wp.zeros(shape, dtype=dtype, device="cpu")


def _launch(kernel: wp.Kernel, *inputs: Any, dim: int = 1) -> None:
    wp.launch(kernel, dim=dim, inputs=list(inputs), device="cpu")
