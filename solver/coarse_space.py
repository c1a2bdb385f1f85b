# SPDX-License-Identifier: GPL-3.0-or-later
"""A coarse space of rigid motions: what makes few iterations enough.

Particles are gathered in box cells; each cell has six rigid modes. Solving the system restricted
to these modes (Galerkin, P^T A P) carries at once what neighbours would pass on over many
iterations: weight, support, whole-body motion. It is used beside a block-Jacobi preconditioner
(additive Schwarz with a coarse space; Toselli and Widlund, *Domain Decomposition Methods*, 2005,
chapter 3), and once more at the end of each solve: then no net impulse is left over in any cell,
so momentum is kept and a block at rest weighs exactly what it should.
"""

import itertools

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .pair_rows import PairRows, pair_direction
from .pairs import Pairs

CELL = 8.0
"""Edge of a cell, in spacings."""
MOST_CELLS = 64
"""Cells grow until no more than this are occupied."""
MODES = 6


@wp.func
def rigid_row(arm: wp.vec3, direction: wp.vec3) -> wp.spatial_vector:
    """How a cell's six rigid modes move a particle along a direction."""
    turn = wp.cross(arm, direction)
    return wp.spatial_vector(direction[0], direction[1], direction[2], turn[0], turn[1], turn[2])


@wp.func
def add_block(
    matrix: wp.array2d[float],
    row: int,
    column: int,
    a: wp.spatial_vector,
    b: wp.spatial_vector,
    scale: float,
) -> None:
    """Add scale a b^T to the 6x6 block of two cells."""
    for p in range(MODES):
        ap = a[p] * scale
        for q in range(MODES):
            wp.atomic_add(matrix, MODES * row + p, MODES * column + q, ap * b[q])


@wp.kernel(enable_backward=False)
def assemble(
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    own_block: wp.array[wp.mat33],
    pairs: PairRows,
    matrix: wp.array2d[float],
) -> None:
    """Sum P^T A P: mass and contacts of each particle, and bonds that join two cells."""
    i = wp.tid()
    own = cell[i]
    x = position[i]
    arm = x - center[own]
    block = own_block[i]
    for axis in range(3):
        unit = wp.vec3(
            wp.where(axis == 0, 1.0, 0.0),
            wp.where(axis == 1, 1.0, 0.0),
            wp.where(axis == 2, 1.0, 0.0),
        )
        add_block(matrix, own, own, rigid_row(arm, unit), rigid_row(arm, block * unit), 1.0)
    for e in range(pairs.count[i]):
        j = pairs.other[i, e]
        theirs = cell[j]
        if theirs != own:
            # Both ends keep the pair: each adds its own row of blocks.
            n = pair_direction(pairs, i, e)
            mine = rigid_row(arm, n)
            add_block(matrix, own, own, mine, mine, pairs.stiffness[i, e])
            add_block(
                matrix, own, theirs, mine, rigid_row(x - center[theirs], n), -pairs.stiffness[i, e]
            )


@wp.kernel(enable_backward=False)
def restrict(
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    residual: wp.array[wp.vec3],
    sums: wp.array[float],
) -> None:
    """Sum the residual onto the cells' modes."""
    i = wp.tid()
    own = cell[i]
    row = rigid_row(position[i] - center[own], residual[i])
    for p in range(MODES):
        wp.atomic_add(sums, MODES * own + p, row[p])


@wp.kernel(enable_backward=False)
def apply_inverse(
    inverse: wp.array2d[float],
    first: wp.array[int],
    last: wp.array[int],
    sums: wp.array[float],
    modes: wp.array[float],
) -> None:
    """Multiply by the inverse of the coarse matrix, block by block."""
    row = wp.tid()
    cell = row // MODES
    total = float(0.0)
    for column in range(MODES * first[cell], MODES * last[cell]):
        total += inverse[row, column] * sums[column]
    modes[row] = total


@wp.func
def prolong(cell: int, arm: wp.vec3, modes: wp.array[float]) -> wp.vec3:
    """Velocity that a cell's modes give a particle."""
    k = MODES * cell
    shift = wp.vec3(modes[k], modes[k + 1], modes[k + 2])
    turn = wp.vec3(modes[k + 3], modes[k + 4], modes[k + 5])
    return shift + wp.cross(turn, arm)


class CoarseSpace:
    """Cells, their matrix and its inverse.

    Args:
        particle_count: Number of particles.
        spacing: Particle spacing [m].
        device: Warp device.
    """

    def __init__(self, particle_count: int, spacing: float, device: wp.Device) -> None:
        self.device = device
        self.particle_count = particle_count
        self.spacing = spacing
        self.cell = wp.zeros(particle_count, dtype=int, device=device)
        self.generation = 0
        self._resize(1)

    def _resize(self, cells: int) -> None:
        self.generation += 1
        size = MODES * cells
        self.center = wp.zeros(cells, dtype=wp.vec3, device=self.device)
        self.first = wp.zeros(cells, dtype=int, device=self.device)
        self.last = wp.zeros(cells, dtype=int, device=self.device)
        self.blocks: list[tuple[int, int]] = []
        self.matrix = wp.zeros((size, size), dtype=float, device=self.device)
        self.inverse = wp.zeros((size, size), dtype=float, device=self.device)
        self.sums = wp.zeros(size, dtype=float, device=self.device)
        self.modes = wp.zeros(size, dtype=float, device=self.device)

    def place_cells(self, position: wp.array) -> None:
        """Lay cells over the particles."""
        points = position.numpy().astype(np.float64)
        low, extent = points.min(0), np.ptp(points, axis=0)
        edge = CELL * self.spacing
        while True:
            counts = np.maximum(np.round(extent / edge), 1.0)
            place = np.minimum((points - low) / np.maximum(extent / counts, 1e-30), counts - 1)
            whole = place.astype(np.int64)
            key = (whole[:, 0] * int(counts[1]) + whole[:, 1]) * int(counts[2]) + whole[:, 2]
            _, occupant, cell = np.unique(key, return_index=True, return_inverse=True)
            cells = len(occupant)
            if cells <= MOST_CELLS:
                break
            edge *= 1.25
        places = whole[occupant]
        group = _connected_groups((np.abs(places[:, None] - places[None]) <= 1).all(2))
        order = np.argsort(group, kind="stable")
        number = np.empty(cells, np.int64)
        number[order] = np.arange(cells)
        cell = number[cell.reshape(-1)]
        starts = np.searchsorted(group[order], np.unique(group))
        self._place_blocks(cells, [*starts.tolist(), cells])
        room = self.center.shape[0]
        sizes = np.bincount(cell, minlength=cells)
        center = np.zeros((room, 3), np.float32)
        center[:cells] = np.stack([np.bincount(cell, axis, cells) / sizes for axis in points.T], 1)
        self.cell.assign(cell.astype(np.int32))
        self.center.assign(center)

    def _place_blocks(self, cells: int, bounds: list[int]) -> None:
        """Note which cells touch each other, directly or through others: only those couple."""
        room = 1 << (cells - 1).bit_length()
        if room > self.center.shape[0]:
            self._resize(room)
        first = np.zeros(room, np.int32)
        last = np.zeros(room, np.int32)
        self.blocks = list(itertools.pairwise(bounds))
        for begin, end in self.blocks:
            first[begin:end], last[begin:end] = begin, end
        self.first.assign(first)
        self.last.assign(last)

    def assemble(self, position: wp.array, own_block: wp.array, pairs: Pairs) -> None:
        """Sum the coarse matrix.

        Args:
            position: Particle positions [m].
            own_block: Mass and contact stiffness of each particle [kg].
            pairs: The acting pairs with their stiffness.
        """
        self.matrix.zero_()
        wp.launch(
            assemble,
            dim=self.particle_count,
            inputs=[
                self.cell,
                self.center,
                position,
                own_block,
                pairs.rows,
                self.matrix,
            ],
            device=self.device,
        )

    def invert(self, least_mass: float) -> None:
        """Invert the coarse matrix, on the host: it is small, and smaller for each body of clay.

        Args:
            least_mass: A particle's mass [kg], to weigh modes that nothing holds.
        """
        matrix = self.matrix.numpy()
        inverse = np.zeros_like(matrix)
        cells = self.blocks[-1][1]
        joined = matrix.reshape(len(self.first), MODES, len(self.first), MODES)[:cells, :, :cells]
        group = _connected_groups(joined.any((1, 3)) | np.eye(cells, dtype=bool))
        for number in np.unique(group):
            members = np.flatnonzero(group == number)
            rows = (MODES * members[:, None] + np.arange(MODES)).ravel()
            part = np.ix_(rows, rows)
            block = matrix[part].astype(np.float64)
            block = 0.5 * (block + block.T)
            # Cells of one or two particles cannot turn; a little inertia keeps them quiet.
            ridge = np.tile([1e-6] * 3 + [0.1 * self.spacing**2] * 3, len(members))
            block[np.diag_indices_from(block)] += ridge * least_mass
            inverse[part] = np.linalg.inv(block)
        self.inverse.assign(inverse)

    def solve(self, position: wp.array, residual: wp.array) -> None:
        """Find the cells' motions for a residual; `prolong` hands them to particles."""
        self.sums.zero_()
        wp.launch(
            restrict,
            dim=self.particle_count,
            inputs=[self.cell, self.center, position, residual, self.sums],
            device=self.device,
        )
        wp.launch(
            apply_inverse,
            dim=self.sums.shape[0],
            inputs=[self.inverse, self.first, self.last, self.sums, self.modes],
            device=self.device,
        )


def _connected_groups(joined: NDArray[np.bool_]) -> NDArray[np.int64]:
    """A number for each group of cells that are joined, directly or through others.

    Args:
        joined: Which pairs of cells are joined, each with itself too, shape [C, C].
    """
    group = np.arange(len(joined))
    while True:
        lowest = np.where(joined, group[None], len(joined)).min(1)
        if np.array_equal(lowest, group):
            return group
        group = lowest
