# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes over pairs for the CPU's vector units against the plain kernels, and the tangent."""

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray

from tactile_clay.solver.plastic_bonds.model import PlasticBonds
from tactile_clay.solver.plastic_bonds.pairs import (
    forces,
    forces_cpu,
    measures,
    measures_cpu,
    neighbors,
    neighbors_cpu,
    products,
    products_cpu,
)
from tactile_clay.tests.solver.plastic_bonds.two_ways import (
    acting,
    compare,
    conditions,
    over_parts,
    per_particle,
)

SPACING = 0.005

GATHERED = ("direction_x", "direction_y", "direction_z", "distance", "distance_next", "other")


def test_pairs_are_gathered_the_same(pressed: PlasticBonds):
    """Find the same pairs, directions, lengths and conditions."""
    rows, body = pressed.pairs.rows, pressed.particles
    law = [pressed.shared_law, pressed.particle_laws, body.material]
    inputs = [*law, body.position, body.velocity, rows]
    compare(
        pressed,
        lambda: body.launch(measures.gather_pairs, *inputs),
        lambda: body.launch_blocks(measures_cpu.gather_pairs, *inputs, pressed.pairs._left),
        [rows.other, rows.rest_length, rows.acting],
        {name: acting(pressed, name) for name in (*GATHERED, "rest_length")}
        | conditions(pressed)
        | per_particle(rows.acting),
        tolerance=1e-4,
    )


def test_pairs_are_measured_the_same(pressed: PlasticBonds):
    """Measure the same lengths, stretches and compressions."""
    rows, body = pressed.pairs.rows, pressed.particles
    inputs = [pressed.shared_law, pressed.particle_laws, body.material, body.velocity, rows]
    compare(
        pressed,
        lambda: body.launch(measures.measure_pairs, *inputs),
        lambda: body.launch_blocks(measures_cpu.measure_pairs, *inputs),
        [],
        {"distance_next": acting(pressed, "distance_next")} | conditions(pressed),
        tolerance=1e-4,
    )


def test_forces_are_the_same(pressed: PlasticBonds):
    """Sum the same forces and tangents."""
    rows, body, solve = pressed.pairs.rows, pressed.particles, pressed.gradients.data
    inputs = [
        pressed.shared_law,
        pressed.pair_laws,
        pressed.particle_laws,
        body.material,
        body.velocity_free,
        body.velocity,
        rows,
        solve.residual,
        pressed.diagonal,
    ]
    compare(
        pressed,
        lambda: body.launch(forces.sum_forces, *inputs),
        lambda: body.launch_blocks(forces_cpu.sum_forces, *inputs),
        [],
        {name: acting(pressed, name) for name in ("stiffness", "slope")}
        | per_particle(solve.residual, pressed.diagonal),
        tolerance=1e-4,
    )


def test_bonds_flow_the_same(pressed: PlasticBonds):
    """Flow to the same rest lengths, and break the same bonds."""
    rows, body = pressed.pairs.rows, pressed.particles
    inputs = [pressed.shared_law, pressed.pair_laws, body.material, body.velocity, rows]
    before = acting(pressed, "rest_length")()
    compare(
        pressed,
        lambda: body.launch(forces.flow_pairs, *inputs),
        lambda: body.launch_blocks(forces_cpu.flow_pairs, *inputs),
        [rows.rest_length],
        {
            "flow": lambda: acting(pressed, "rest_length")() - before,
            "rest_length": acting(pressed, "rest_length"),
        },
        tolerance=1e-4,
    )


def test_products_are_the_same(pressed: PlasticBonds):
    """Compute the same product with any direction."""
    body, solve = pressed.particles, pressed.gradients.data
    direction = np.random.default_rng(2).normal(size=(body.count, 4))
    direction[:, 3] = 0.0
    solve.direction.assign(direction.astype(np.float32))

    def multiply(module: object, launch: Callable[..., None]) -> None:
        solve.curvature.zero_()
        press = [
            pressed.shared_law,
            pressed.particle_laws,
            body.material,
            pressed.pairs.rows,
            solve.direction,
        ]
        launch(module.press_pairs, *press)  # type: ignore[attr-defined]
        inputs = [
            pressed.shared_law,
            pressed.pairs.rows,
            pressed.own_block,
            solve.direction,
            solve.product,
        ]
        launch(module.multiply_pairs, *inputs, solve.curvature, 0)  # type: ignore[attr-defined]

    compare(
        pressed,
        lambda: multiply(products, body.launch),
        lambda: multiply(products_cpu, body.launch_blocks),
        [solve.direction],
        per_particle(solve.direction, solve.product) | over_parts(solve.curvature),
    )


def test_tangent_is_symmetric_and_positive(pressed: PlasticBonds):
    """Have a symmetric, positive definite tangent, as conjugate gradients require."""
    count, solve = pressed.particles.count, pressed.gradients.data
    generator = np.random.default_rng(3)
    vectors = [generator.normal(size=(count, 3)).astype(np.float32) for _ in range(2)]
    products = []
    for vector in vectors:
        solve.direction.assign(np.pad(vector, ((0, 0), (0, 1))))
        pressed.pairs.multiply(
            pressed.shared_law,
            pressed.particle_laws,
            pressed.own_block,
            solve.direction,
            solve.product,
            solve.curvature,
            0,
        )
        products.append(solve.product.numpy().astype(float))
    one_two = float((vectors[0] * products[1]).sum())
    two_one = float((vectors[1] * products[0]).sum())
    energy = float((vectors[0] * products[0]).sum())
    assert energy > 0
    assert one_two == pytest.approx(two_one, abs=1e-5 * energy)


def test_rest_lengths_are_equal_at_both_ends(pressed: PlasticBonds):
    """Keep the same rest length at both ends of every bond, to float32 rounding."""
    rows = pressed.pairs.rows
    first, count = rows.first.numpy(), rows.acting.numpy()
    other, length = rows.other.numpy(), rows.rest_length.numpy()
    kept = {
        (i, int(other[s])): length[s]
        for i in range(len(first))
        for s in range(first[i], first[i] + count[i])
        if length[s] > 0
    }
    assert len(kept) > 10 * len(count)
    worst = max(abs(value - kept.get((j, i), np.inf)) / SPACING for (i, j), value in kept.items())
    assert worst < 1e-4


def test_rows_are_filled_the_same(pressed: PlasticBonds):
    """List the same neighbors from sorted cells as from a hash grid."""
    body, rows = pressed.particles, pressed.pairs.rows
    # Rows that are too short keep an arbitrary part of the neighbors.
    pressed.neighbors.rebuild()
    reach = pressed.neighbors.reach
    grid = wp.HashGrid(16, 16, 16, device="cpu")
    grid.build(body.position, reach)
    needed = wp.zeros(body.count, dtype=int, device="cpu")

    def listed() -> NDArray:
        first, count = rows.first.numpy(), rows.listed.numpy()
        other = rows.other.numpy()
        return np.concatenate(
            [np.sort(other[f : f + c]) for f, c in zip(first, count, strict=True)]
        )

    def from_cells() -> None:
        cells = neighbors_cpu.make_cell_grid(body, reach)
        neighbors_cpu.sort_into_cells(cells, body, reach)
        body.launch(neighbors_cpu.fill_rows, cells, body.position, reach, rows, needed)

    compare(
        pressed,
        lambda: body.launch(neighbors.fill_rows, grid.id, body.position, reach, rows, needed),
        from_cells,
        [rows.other, rows.rest_length, rows.listed, rows.acting],
        {"needed": needed.numpy, "listed": listed},
        tolerance=0.0,
    )
