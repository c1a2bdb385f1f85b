# SPDX-License-Identifier: GPL-3.0-or-later
"""A coarse space of rigid motions, with which few iterations suffice.

Particles are grouped in box cells; each cell has six rigid modes. Solving the system restricted to
these modes (Galerkin, P^T A P) transmits at once what would take many iterations by neighbors:
weight, support, whole-body motion. It is used with a block-Jacobi preconditioner (additive Schwarz
with a coarse space; Toselli and Widlund, *Domain Decomposition Methods*, 2005, chapter 3), and once
more at the end of each solve: then no net impulse is left in any cell, so momentum is conserved and
a block at rest has exactly its weight.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ...core.awake import Awake, awake_particle
from ...core.grid_boxes import box_of
from ...core.particles import ByPart, Particles, zeros_with_room
from ..pairs.pairs import Pairs
from . import coarse_space_cpu
from .coarse_modes import MODES, assemble, rigid_row

CELL = 8.0
"""Edge of a cell, in spacings."""
MAX_CELLS = 64
"""Cells are enlarged until at most this many are occupied."""
_GRID_LIMIT = 1 << 18
_REBUILDS = 4
"""Cells are laid out again after this many rebuilds of the neighbor lists."""


@wp.func
def add_to_modes(
    sums: wp.array2d[wp.float64], part: int, cell: int, arm: wp.vec3, impulse: wp.vec3
) -> None:
    """Add an impulse to the sums of a cell's modes."""
    row = rigid_row(arm, impulse)
    for p in range(MODES):
        wp.atomic_add(sums, part, MODES * cell + p, wp.float64(row[p]))


@wp.func
def prolong(cell: int, arm: wp.vec3, modes: wp.array2d[float], part: int) -> wp.vec3:
    """Velocity that a cell's modes give a particle."""
    k = MODES * cell
    shift = wp.vec3(modes[part, k], modes[part, k + 1], modes[part, k + 2])
    turn = wp.vec3(modes[part, k + 3], modes[part, k + 4], modes[part, k + 5])
    return shift + wp.cross(turn, arm)


@wp.kernel(enable_backward=False)
def find_boxes(
    awake: Awake,
    position: wp.array[wp.vec3],
    low: wp.vec3,
    inverse_edge: wp.vec3,
    counts: wp.vec3i,
    cell: wp.array[int],
    occupants: wp.array[int],
    sums: wp.array[wp.vec3],
) -> None:
    """Find the box in which each particle lies, and sum the boxes' occupants."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    place = box_of(position[i], low, inverse_edge, counts)
    box = (place[0] * counts[1] + place[1]) * counts[2] + place[2]
    cell[i] = box
    wp.atomic_add(occupants, box, 1)
    wp.atomic_add(sums, box, position[i] - low)


@wp.kernel(enable_backward=False)
def number_cells(awake: Awake, number: wp.array[int], cell: wp.array[int]) -> None:
    """Replace each particle's box by its index among the occupied boxes."""
    i = awake_particle(awake, wp.tid())
    if i >= 0:
        cell[i] = number[cell[i]]


@wp.kernel(enable_backward=False)
def apply_inverse(
    size: wp.array[int],
    inverse: wp.array2d[float],
    sums: wp.array2d[wp.float64],
    modes: wp.array2d[float],
    energy: wp.array2d[wp.float64],
    place: int,
) -> None:
    """Multiply by the inverse of the coarse matrix."""
    row = wp.tid()
    if row >= size[0]:
        return
    total = float(0.0)
    for column in range(size[0]):
        total += inverse[row, column] * float(sums[0, column])
    modes[0, row] = total
    wp.atomic_add(energy, 0, place, wp.float64(total) * sums[0, row])


class CoarseSpace:
    """Cells, their matrix and its inverse.

    Args:
        particles: The particles in the cells.
    """

    def __init__(self, particles: Particles) -> None:
        self.particles = particles
        self.device = particles.device
        self.cell = wp.zeros(particles.count, dtype=int, device=self.device)
        self.generation = 0
        self.placed_at = -_REBUILDS
        self.size = wp.zeros(1, dtype=int, device=self.device)
        """Number of rows of the matrix in use."""
        # Cells of one or two particles have no definite rotation; a little inertia keeps it small.
        ridge = [1e-6] * 3 + [0.1 * particles.spacing**2] * 3
        self.ridge = np.array(ridge) * particles.min_mass
        self._resize(1)

    def _resize(self, cells: int) -> None:
        self.generation += 1
        size = MODES * cells
        self.center = zeros_with_room(cells, wp.vec3, self.device)
        # Vector units add eight numbers where a mode has six.
        parts = self.particles.parts
        self.matrix = wp.zeros((parts, size + 1, size + 8), dtype=float, device=self.device)
        if self.device.is_cpu:
            self.factor = coarse_space_cpu.Factor(size, self.particles)
        else:
            self.inverse = wp.zeros((size, size), dtype=float, device=self.device)
        self.sums = wp.zeros((parts, size), dtype=wp.float64, device=self.device)
        # Vector units read eight numbers here too.
        self.modes = wp.zeros((parts, size + 2), dtype=float, device=self.device)

    def place_cells(self, rebuild_count: int) -> None:
        """Lay out cells over the particles, unless the last layout is still good.

        Args:
            rebuild_count: How often the neighbor lists were filled, a measure of motion.
        """
        if rebuild_count < self.placed_at + _REBUILDS:
            return
        self.placed_at = rebuild_count
        particles = self.particles
        low, high = particles.awake_box
        extent = (high - low).astype(np.float64)
        edge = CELL * particles.spacing
        while True:
            counts = np.maximum(np.round(extent / edge), 1.0)
            if np.prod(counts) <= _GRID_LIMIT:
                boxes = counts.astype(int)
                occupants, sums = self._fill_boxes(low, extent, boxes)
                occupied = np.flatnonzero(occupants)
                if len(occupied) <= MAX_CELLS:
                    break
            edge *= 1.25
        places = np.stack(np.unravel_index(occupied, boxes), 1)
        group = connected_groups((np.abs(places[:, None] - places[None]) <= 1).all(2))
        order = np.argsort(group, kind="stable")
        number = np.zeros(len(occupants), np.int32)
        number[occupied[order]] = np.arange(len(occupied))
        particles.launch(number_cells, wp.array(number, dtype=int, device=self.device), self.cell)
        room = 1 << (len(occupied) - 1).bit_length()
        if room > len(self.center):
            self._resize(room)
        center = np.zeros((len(self.center), 3), np.float32)
        chosen = occupied[order]
        center[: len(chosen)] = low + sums[chosen] / occupants[chosen, None]
        self.center.assign(center)
        self.size.fill_(MODES * len(occupied))

    def release(self, resting: NDArray[np.int64]) -> None:
        """Drop particles that fell asleep, and have new cells laid out before the next solve."""
        cell = self.cell.numpy().copy()
        cell[resting] = -1
        self.cell.assign(cell)
        self.placed_at = -_REBUILDS

    def snapshot(self) -> dict[str, NDArray]:
        """The layout of the cells."""
        return {
            "coarse_cell": self.cell.numpy().copy(),
            "coarse_center": self.center.numpy().copy(),
            "coarse_counts": np.array([int(self.size.numpy()[0]), self.placed_at]),
        }

    def restore(self, state: dict[str, NDArray]) -> None:
        """Restore the state that `snapshot` returned."""
        if len(state["coarse_center"]) > len(self.center):
            self._resize(len(state["coarse_center"]))
        center = np.zeros((len(self.center), 3), np.float32)
        center[: len(state["coarse_center"])] = state["coarse_center"]
        self.center.assign(center)
        self.cell.assign(state["coarse_cell"])
        size, self.placed_at = (int(n) for n in state["coarse_counts"])
        self.size.fill_(size)

    def _fill_boxes(self, low: NDArray, extent: NDArray, boxes: NDArray) -> tuple[NDArray, NDArray]:
        """Count the particles in each box of a grid, and sum their positions."""
        total = int(np.prod(boxes))
        occupants = wp.zeros(total, dtype=int, device=self.device)
        sums = wp.zeros(total, dtype=wp.vec3, device=self.device)
        inverse = boxes * (1.0 - 1e-6) / np.maximum(extent, 1e-30)
        self.particles.launch(
            find_boxes,
            self.particles.position,
            wp.vec3(*low),
            wp.vec3(*inverse),
            wp.vec3i(*boxes.tolist()),
            self.cell,
            occupants,
            sums,
        )
        return occupants.numpy(), sums.numpy()

    def assemble(self, own_block: wp.array, pairs: Pairs) -> None:
        """Sum the coarse matrix.

        Args:
            own_block: Mass and contact stiffness of each particle [kg].
            pairs: The acting pairs with their stiffness.
        """
        matrix = ByPart.rows(self.matrix)
        self.particles.zero(matrix)
        self.particles.run(
            assemble,
            coarse_space_cpu.assemble,
            self.cell,
            self.center,
            self.particles.position,
            own_block,
            pairs.rows,
            matrix,
        )
        if self.device.is_cpu:
            self.factor.factorize(self.size, self.center, self.ridge, self.matrix)

    def invert(self) -> None:
        """Invert the coarse matrix on the host, for a GPU; the CPU uses a factorization."""
        if self.device.is_cpu:
            return
        cells = int(self.size.numpy()[0]) // MODES
        matrix = join_blocks(self.matrix.numpy().sum(0), self.center.numpy()[:cells])
        matrix[np.diag_indices_from(matrix)] += np.tile(self.ridge, cells)
        inverse = np.zeros(self.inverse.shape, np.float32)
        inverse[: len(matrix), : len(matrix)] = np.linalg.inv(matrix)
        self.inverse.assign(inverse)

    def solve(self, energy: wp.array, place: int) -> None:
        """Find the cells' motions from the summed residual; `prolong` maps them to particles.

        Args:
            energy: Residual times motion, added to at ``place`` [J].
            place: Column of ``energy``.
        """
        if self.device.is_cpu:
            self.factor.solve(self.size, self.sums, self.modes, energy, place)
            return
        wp.launch(
            apply_inverse,
            dim=self.sums.shape[1],
            inputs=[self.size, self.inverse, self.sums, self.modes, energy, place],
            device=self.device,
        )


def join_blocks(matrix: NDArray[np.float32], center: NDArray[np.float32]) -> NDArray[np.float64]:
    """Build the coarse matrix from the sums of `assemble`.

    Args:
        matrix: The blocks summed by `assemble`.
        center: Centers of the cells [m], shape [C, 3].

    Returns:
        P^T A P, symmetric, shape [6 C, 6 C].
    """
    cells = len(center)
    size = MODES * cells
    blocks = matrix[:size, :size].astype(np.float64).reshape(cells, MODES, cells, MODES)
    full = np.zeros_like(blocks)
    for a in range(cells):
        for b in range(cells):
            block = blocks[a, :, b]
            full[a, :, a] += block
            if a != b:
                turned = block.copy()
                turned[:, 3:] += np.cross(center[a] - center[b], block[:, :3])
                full[a, :, b] = -turned
    joined = full.reshape(size, size)
    return 0.5 * (joined + joined.T)


def connected_groups(joined: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Label of each cell's connected group, shape [C].

    Args:
        joined: Whether two cells are joined, true on the diagonal, shape [C, C].
    """
    group = np.arange(len(joined))
    while True:
        lowest = np.where(joined, group[None], len(joined)).min(1)
        if np.array_equal(lowest, group):
            return group
        group = lowest
