# SPDX-License-Identifier: GPL-3.0-or-later
"""The solve's passes for the CPU against the plain kernels, and the coarse space."""

import numpy as np
import pytest
import warp as wp

from tactile_clay.solver.core.particles import ByPart
from tactile_clay.solver.plastic_bonds.model import PlasticBonds
from tactile_clay.solver.plastic_bonds.solve import (
    coarse_modes,
    coarse_space,
    coarse_space_cpu,
    conjugate_gradients,
    conjugate_gradients_cpu,
)
from tactile_clay.tests.solver.plastic_bonds.two_ways import (
    compare,
    over_parts,
    per_particle,
)


@pytest.mark.parametrize("name", ["start", "turn", "advance", "finish"])
def test_conjugate_gradients_are_the_same(pressed: PlasticBonds, name: str):
    """Compute the same vectors and sums in each pass of an iteration."""
    body, solve = pressed.particles, pressed.gradients.data
    solve.cell, solve.center = pressed.coarse.cell, pressed.coarse.center
    solve.sums, solve.modes = pressed.coarse.sums, pressed.coarse.modes
    generator = np.random.default_rng(4)
    for array in (solve.residual, solve.z, solve.direction, solve.product, solve.change):
        array.assign(generator.normal(size=array.numpy().shape).astype(np.float32))
    copies = solve.modes.shape[0]
    assert copies == 2
    modes = generator.normal(size=solve.modes.shape[1]).astype(np.float32)
    solve.modes.assign(np.stack([modes] * copies))
    coarse_size = generator.uniform(1.0, 2.0, solve.coarse_size.shape[1])
    solve.coarse_size.assign(np.stack([coarse_size] * copies))
    for sums in (solve.size, solve.curvature):
        sums.assign(generator.uniform(1.0, 2.0, sums.shape))
    inputs = {
        "start": [pressed.diagonal, solve],
        "turn": [1, solve],
        "advance": [1, solve],
        "finish": [solve, body.velocity],
    }[name]
    vectors = [solve.residual, solve.z, solve.direction, body.velocity]
    if name != "start":
        vectors.append(solve.change)
    compare(
        pressed,
        lambda: body.launch(getattr(conjugate_gradients, name), *inputs),
        lambda: body.launch_blocks(getattr(conjugate_gradients_cpu, name), *inputs),
        [*vectors, solve.sums, solve.size],
        per_particle(*vectors, solve.inverse) | over_parts(solve.sums, solve.size),
        tolerance=2e-5,
    )


def test_coarse_matrix_is_the_galerkin_one(pressed: PlasticBonds):
    """Sum, by both kernels, the particles' tangent projected onto the coarse modes."""
    body, coarse, rows = pressed.particles, pressed.coarse, pressed.pairs.rows
    inputs = [coarse.cell, coarse.center, body.position, pressed.own_block, rows]
    size = int(coarse.size.numpy()[0])
    center = coarse.center.numpy()[: size // 6]
    cell, arm = coarse.cell.numpy(), body.position.numpy() - center[coarse.cell.numpy()]
    modes = np.zeros((body.count, 3, size))
    for mode in range(6):
        column = 6 * cell + mode
        unit = np.eye(3)[mode % 3]
        motion = np.broadcast_to(unit, arm.shape) if mode < 3 else np.cross(unit, arm)
        modes[np.arange(body.count), :, column] = motion
    expected = np.zeros((size, size))
    own = pressed.own_block.numpy().astype(float)
    expected += np.einsum("nar,nab,nbs->rs", modes, own, modes, optimize=True)
    first, count = rows.first.numpy(), rows.acting.numpy()
    for i in range(body.count):
        slots = slice(first[i], first[i] + count[i])
        n = np.stack([getattr(rows, f"direction_{a}").numpy()[slots] for a in "xyz"], 1)
        pull = np.einsum("ea,ear->er", n, modes[i] - modes[rows.other.numpy()[slots]])
        stiffness = rows.stiffness.numpy()[slots].astype(float)
        expected += 0.5 * (pull * stiffness[:, None]).T @ pull
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    for kernel, launch in (
        (coarse_modes.assemble, body.launch),
        (coarse_space_cpu.assemble, body.launch_blocks),
    ):
        coarse.matrix.zero_()
        by_part = ByPart.rows(coarse.matrix)
        launch(kernel, *inputs, by_part[0] if kernel is coarse_modes.assemble else by_part)
        joined = coarse_space.join_blocks(coarse.matrix.numpy().sum(0), center)
        np.testing.assert_allclose(joined / scale, expected / scale, atol=1e-4)


def test_coarse_solve_is_exact(pressed: PlasticBonds):
    """Solve the coarse system like a dense solver."""
    coarse = pressed.coarse
    coarse.assemble(pressed.own_block, pressed.pairs)
    size = int(coarse.size.numpy()[0])
    summed = coarse.matrix.numpy().sum(0)
    matrix = coarse_space.join_blocks(summed, coarse.center.numpy()[: size // 6])
    matrix[np.diag_indices(size)] += np.tile(coarse.ridge, size // 6)
    # An impulse on every cell, with an angular part scaled to the cell's size.
    sums = np.random.default_rng(5).normal(size=size) * np.sqrt(np.diag(matrix))
    padded = np.zeros(coarse.sums.shape)
    padded[:, :size] = 0.25 * sums, 0.75 * sums
    coarse.sums.assign(padded)
    energy = wp.zeros((2, 1), dtype=wp.float64, device="cpu")
    coarse.solve(energy, 0)
    expected = np.linalg.solve(matrix, sums)
    scale = np.sqrt(np.diag(matrix))
    for modes in coarse.modes.numpy():
        tolerance = 1e-4 * np.abs(expected * scale).max()
        np.testing.assert_allclose(modes[:size] * scale, expected * scale, rtol=0, atol=tolerance)
    np.testing.assert_allclose(energy.numpy(), float(expected @ sums), rtol=1e-4)
