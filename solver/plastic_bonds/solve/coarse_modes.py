# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigid modes of coarse cells, and the sums that make up the coarse matrix.

A bond between cells a and b pulls along its direction n with a stiffness k. Its row of modes in a
cell is r = (n, (x - c) × n), and since the line along n goes through both ends, r_b follows from
r_a alone. So for each pair of cells only the sum of k r_a r_a^T is gathered, at block (a, b);
`coarse_space.join_blocks` and `coarse_space_cpu.factor` build the matrix from it.
"""

import warp as wp

from ...core.awake import Awake, awake_particle
from ..pairs.rows import PairRows, pair_direction

MODES = 6
"""Modes of a cell: three translations and three rotations."""


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


@wp.func
def add_own_block(matrix: wp.array2d[float], cell: int, arm: wp.vec3, block: wp.mat33) -> None:
    """Add a particle's mass and contacts to its cell's block."""
    for axis in range(3):
        unit = wp.vec3(
            wp.where(axis == 0, 1.0, 0.0),
            wp.where(axis == 1, 1.0, 0.0),
            wp.where(axis == 2, 1.0, 0.0),
        )
        add_block(matrix, cell, cell, rigid_row(arm, unit), rigid_row(arm, block * unit), 1.0)


@wp.kernel(enable_backward=False)
def assemble(
    awake: Awake,
    cell: wp.array[int],
    center: wp.array[wp.vec3],
    position: wp.array[wp.vec3],
    own_block: wp.array[wp.mat33],
    pairs: PairRows,
    matrix: wp.array2d[float],
) -> None:
    """Sum the mass and contacts of each particle, and the bonds that join two cells."""
    i = awake_particle(awake, wp.tid())
    if i < 0:
        return
    own = cell[i]
    arm = position[i] - center[own]
    add_own_block(matrix, own, arm, own_block[i])
    for slot in range(pairs.first[i], pairs.first[i] + pairs.acting[i]):
        theirs = cell[pairs.other[slot]]
        if theirs != own:
            # A sleeping neighbor acts as a wall.
            column = wp.where(theirs < 0, own, theirs)
            row = rigid_row(arm, pair_direction(pairs, slot))
            add_block(matrix, own, column, row, row, pairs.stiffness[slot])
