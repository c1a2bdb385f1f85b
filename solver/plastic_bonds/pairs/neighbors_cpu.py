# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbor search on the CPU: particles sorted by cell, and rows filled by vector units.

The passes are those of `neighbors`; a test compares the two.
"""

from typing import Any

import numpy as np
import warp as wp

from ...core.awake import Awake, awake_particle
from ...core.grid_boxes import box_of
from ...core.particles import Particles
from ...core.vector_units import OPTIONS, VECTORS, over_block
from .rows import PairRows, keep_bonds

wp.set_module_options(OPTIONS)

_CELL_LIMIT = 1 << 20


@wp.struct
class CellGrid:
    """Particles sorted by cell, for the CPU."""

    low: wp.vec3
    """Corner of the first cell [m]."""
    inverse_edge: wp.vec3
    counts: wp.vec3i
    """Number of cells along each axis."""
    cell: wp.array[int]
    """Cell of each particle; -1 outside the box."""
    start: wp.array[int]
    """Start of each cell's particles in ``order``."""
    order: wp.array[int]
    """Particles, sorted by cell."""
    x: wp.array[float]
    y: wp.array[float]
    z: wp.array[float]
    """Their positions in that order [m]."""
    mark: wp.array2d[int]
    """Scratch marks of each particle, by part."""
    box_low: wp.vec3
    """Nothing outside this box is a neighbor of an awake particle [m]."""
    box_high: wp.vec3


@wp.kernel(enable_backward=False)
def find_cells(position: wp.array[wp.vec3], grid: CellGrid) -> None:
    """Count the particles in each cell; those outside the grid belong to its outermost cells."""
    i = wp.tid()
    below = wp.max(grid.box_low - position[i])
    above = wp.max(position[i] - grid.box_high)
    if wp.max(below, above) > 0.0:
        grid.cell[i] = -1
        return
    place = box_of(position[i], grid.low, grid.inverse_edge, grid.counts)
    cell = (place[2] * grid.counts[1] + place[1]) * grid.counts[0] + place[0]
    grid.cell[i] = cell
    wp.atomic_add(grid.start, cell + 1, 1)


@wp.kernel(enable_backward=False)
def sum_starts(cells: int, grid: CellGrid) -> None:
    """Turn counts into the starts of cells."""
    total = int(0)
    for cell in range(cells):
        total += grid.start[cell]
        grid.start[cell] = total


@wp.kernel(enable_backward=False)
def sort_by_cell(position: wp.array[wp.vec3], grid: CellGrid) -> None:
    """Sort the particles by cell; this moves each start to its cell's end."""
    i = wp.tid()
    if grid.cell[i] < 0:
        return
    slot = wp.atomic_add(grid.start, grid.cell[i], 1)
    grid.order[slot] = i
    grid.x[slot] = position[i][0]
    grid.y[slot] = position[i][1]
    grid.z[slot] = position[i][2]


# Cells along x are contiguous: nine runs hold all neighbors.
@wp.func_native(
    VECTORS
    + """
    const long long row = pairs.first.data[i];
    const int room = pairs.room.data[i];
    int* other = pairs.other.data + row;
    float* rests = pairs.rest_length.data + row;
    int* mark = grid.mark.data + part * (long long)grid.mark.shape[1];
    for (int e = 0; e < bonded; e++) mark[other[e]] = i;
    mark[i] = i;
    const float* p = (const float*)position.data + 3 * (long long)i;
    const int nx = grid.counts[0], ny = grid.counts[1], nz = grid.counts[2];
    const int cell = grid.cell.data[i];
    const int cx = cell % nx, cy = (cell / nx) % ny, cz = cell / (nx * ny);
    const int x0 = cx > 0 ? cx - 1 : 0, x1 = cx + 1 < nx ? cx + 1 : nx - 1;
    const int y0 = cy > 0 ? cy - 1 : 0, y1 = cy + 1 < ny ? cy + 1 : ny - 1;
    const int z0 = cz > 0 ? cz - 1 : 0, z1 = cz + 1 < nz ? cz + 1 : nz - 1;
    const f8 limit = (f8)(reach * reach);
    int used = bonded;
    for (int z = z0; z <= z1; z++) for (int y = y0; y <= y1; y++) {
        const int line = (z * ny + y) * nx;
        // A start has moved to its cell's end: the cell before it ends where it began.
        const int begin = line + x0 > 0 ? grid.start.data[line + x0 - 1] : 0;
        const int end = grid.start.data[line + x1];
        for (int s = begin; s < end; s += 8) {
            const f8 dx = load(grid.x.data + s) - p[0];
            const f8 dy = load(grid.y.data + s) - p[1];
            const f8 dz = load(grid.z.data + s) - p[2];
            const i8 near = (dx * dx + dy * dy + dz * dz < limit) & (lanes + s < end);
            if (!__builtin_reduce_or(near)) continue;
            int found[8], count = 0;
            for (int l = 0; l < 8; l++) {
                found[count] = grid.order.data[s + l];
                count -= near[l];
            }
            for (int l = 0; l < count; l++) {
                const int j = found[l];
                if (mark[j] == i) continue;
                if (used < room) {
                    other[used] = j;
                    rests[used] = 0.f;
                }
                used++;
            }
        }
    }
    pairs.listed.data[i] = used < room ? used : room;
    return used;
}"""
)
def fill_row(  # type: ignore[empty-body]
    i: int,
    part: int,
    bonded: int,
    reach: float,
    position: wp.array[wp.vec3],
    grid: CellGrid,
    pairs: PairRows,
) -> int: ...


@wp.kernel(enable_backward=False)
def fill_rows(
    awake: Awake,
    grid: CellGrid,
    position: wp.array[wp.vec3],
    reach: float,
    pairs: PairRows,
    needed: wp.array[int],
) -> None:
    """`neighbors.fill_rows`, from particles sorted by cell."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    bonded = keep_bonds(pairs, i)
    needed[i] = fill_row(i, awake.part, bonded, reach, position, grid, pairs)


@wp.func_native(
    over_block(
        "float max_square = 0.f; const float* m = (const float*)frame.data;",
        """
    const float* x = (const float*)position.data + 3 * (long long)i;
    const float* y = (const float*)listed_position.data + 3 * (long long)i;
    const float a = x[0] - (m[0] * y[0] + m[1] * y[1] + m[2] * y[2] + m[3]);
    const float b = x[1] - (m[4] * y[0] + m[5] * y[1] + m[6] * y[2] + m[7]);
    const float c = x[2] - (m[8] * y[0] + m[9] * y[1] + m[10] * y[2] + m[11]);
    const float square = a * a + b * b + c * c;
    max_square = square > max_square ? square : max_square;
""",
        "if (max_square > largest.data[0]) largest.data[0] = max_square;",
    )
)
def measure_block(
    block: int,
    awake: Awake,
    position: wp.array[wp.vec3],
    listed_position: wp.array[wp.vec3],
    frame: wp.array[wp.mat44],
    largest: wp.array[float],
) -> None: ...


@wp.kernel(enable_backward=False)
def measure_displacement(
    awake: Awake,
    position: wp.array[wp.vec3],
    listed_position: wp.array[wp.vec3],
    frame: wp.array[wp.mat44],
    largest: wp.array[float],
) -> None:
    """`neighbors.measure_displacement`."""
    measure_block(wp.tid(), awake, position, listed_position, frame, largest)


def make_cell_grid(particles: Particles, reach: float) -> CellGrid:
    """Allocate a grid for all particles, with cells of edge ``reach`` [m]."""
    grid = CellGrid()
    particle_count, device = particles.count, particles.device
    for name in ("cell", "order"):
        setattr(grid, name, wp.zeros(particle_count + 8, dtype=int, device=device))
    for name in ("x", "y", "z"):
        # Vector units read up to seven numbers past the end.
        setattr(grid, name, wp.zeros(particle_count + 8, dtype=float, device=device))
    grid.mark = wp.zeros((particles.parts, particle_count + 8), dtype=int, device=device)
    grid.start = wp.zeros(1, dtype=int, device=device)
    grid.inverse_edge = wp.vec3(1.0 / reach)
    return grid


def sort_into_cells(grid: CellGrid, particles: Particles, reach: float) -> None:
    """Sort by cell the particles that may be neighbors of awake ones.

    Args:
        grid: A grid returned by `make_cell_grid`.
        particles: The particles.
        reach: Edge of a cell, and the largest distance of neighbors [m].
    """
    position = particles.position
    points = position.numpy()
    awake = points[particles.awake_index()]
    low, high = awake.min(0) - reach, awake.max(0) + reach
    grid.box_low, grid.box_high = wp.vec3(*low), wp.vec3(*high)
    counts = np.floor((high - low) / reach) + 1.0
    if np.prod(counts) > _CELL_LIMIT:
        # The bulk of the clay decides where cells lie; strays share the outermost ones.
        low, high = np.quantile(awake, [0.01, 0.99], axis=0)
        counts = np.floor((high - low) / reach) + 1.0
        counts *= min(1.0, float(np.cbrt(_CELL_LIMIT / np.prod(counts))))
    counts = np.clip(counts, 1.0, _CELL_LIMIT).astype(int)
    cells = int(np.prod(counts))
    if cells + 1 > len(grid.start):
        grid.start = wp.zeros(cells + 1, dtype=int, device=position.device)
    else:
        grid.start.zero_()
    grid.mark.fill_(-1)
    grid.low = wp.vec3(*low)
    grid.counts = wp.vec3i(*counts.tolist())

    def launch(kernel: wp.Kernel, dim: int, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=list(inputs), device=position.device)

    launch(find_cells, len(points), position, grid)
    launch(sum_starts, 1, cells + 1, grid)
    launch(sort_by_cell, len(points), position, grid)
