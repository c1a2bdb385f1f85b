# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes for the CPU's vector units against the plain kernels, and the tangent."""

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.solver.contact import contacts_cpu as contact_cpu
from tactile_clay.solver.contact import law as contact_law
from tactile_clay.solver.contact import search as contact_search
from tactile_clay.solver.core import particles, particles_cpu
from tactile_clay.solver.core.particles import ByPart
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
from tactile_clay.solver.plastic_bonds.solve import (
    coarse_modes,
    coarse_space,
    coarse_space_cpu,
    conjugate_gradients,
    conjugate_gradients_cpu,
)
from tactile_clay.tests.experiments.shapes import at, ball, block
from tactile_clay.tests.solver.plastic_bonds.pairs.two_ways import (
    acting,
    compare,
    conditions,
    over_parts,
    per_particle,
)

SPACING = 0.005
STEP = 1 / 240


@pytest.fixture(scope="module")
def pressed() -> PlasticBonds:
    """Two materials in the middle of a press: compressed, stretched and yielding."""
    scene = Scene(SPACING)
    points = block((16, 9, 9), SPACING)
    points += np.random.default_rng(1).uniform(-0.1, 0.1, points.shape) * SPACING
    left = points[:, 0] < 0
    thin = Material(yield_stress=2e3, density=1200.0, shear_modulus=5e4, flow_index=0.5)
    scene.add_clay(points[left], Material())
    scene.add_clay(points[~left], thin)
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 0.057))
    solver = Solver(scene)
    for frame in range(10):
        tool.set_pose(at(0, 0, 0.057 - 0.001 * frame))
        solver.step(1 / 60)
    model = solver._model
    assert isinstance(model, PlasticBonds)
    assert model.compression().max() > 0
    assert model.coarse.size.numpy()[0] > 6
    return model


LAID = ("direction_x", "direction_y", "direction_z", "distance", "distance_next", "other")


def test_pairs_are_laid_the_same(pressed: PlasticBonds):
    """Find the same pairs, directions, lengths and volumes."""
    rows, body = pressed.pairs.rows, pressed.particles
    law = [pressed.shared_law, pressed.particle_laws, body.material]
    inputs = [*law, body.position, body.velocity, rows]
    compare(
        pressed,
        lambda: body.launch(measures.lay_pairs, *inputs),
        lambda: body.launch_blocks(measures_cpu.lay_pairs, *inputs, pressed.pairs._left),
        [rows.other, rows.rest_length, rows.acting],
        {name: acting(pressed, name) for name in (*LAID, "rest_length")}
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
    """Sum the same forces and tangents, law and all."""
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
    """Multiply any direction to the same product."""
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


@pytest.mark.parametrize("name", ["start", "turn", "advance", "finish"])
def test_conjugate_gradients_go_the_same_way(pressed: PlasticBonds, name: str):
    """Leave the same vectors and sums after each pass of an iteration."""
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
    """Sum, on both ways, the matrix that the particles' tangent has on the coarse modes."""
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
    """Solve the coarse system like a dense solver does."""
    coarse = pressed.coarse
    coarse.assemble(pressed.own_block, pressed.pairs)
    size = int(coarse.size.numpy()[0])
    summed = coarse.matrix.numpy().sum(0)
    matrix = coarse_space.join_blocks(summed, coarse.center.numpy()[: size // 6])
    matrix[np.diag_indices(size)] += np.tile(coarse.ridge, size // 6)
    # An impulse on every cell, with a turn that fits the cell's size.
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


def test_contacts_are_found_the_same(pressed: PlasticBonds):
    """Find the same contacts whether particles are screened or each is asked."""
    body, contacts = pressed.particles, pressed.contacts
    slots, around = contacts.slots, contacts._surroundings
    common = contact_law.ContactPass()
    common.time_step = common.time_step_before = STEP
    common.radius, common.margin = 0.5 * SPACING, contact_law.MARGIN * SPACING
    inputs = [common, around, body.position, body.velocity, slots]
    compare(
        pressed,
        lambda: body.launch(contact_search.find_all_contacts, *inputs),
        lambda: body.launch_blocks(contact_cpu.find_all_contacts, *inputs, contacts._near),
        [slots.count, slots.collider, slots.anchor, around.clearance],
        per_particle(slots.count, slots.gap, slots.normal, around.clearance),
    )


def test_particles_fall_and_move_the_same(pressed: PlasticBonds):
    """Fall, move, clamp and quarantine the same."""
    body = pressed.particles
    body.speed_limit.fill_(0.1)
    velocity = np.random.default_rng(6).normal(size=(body.count, 3)).astype(np.float32) * 0.05
    velocity[7] = np.nan
    velocity[9, 1] = np.inf
    kept = body.velocity.numpy().copy()
    body.velocity.assign(velocity)
    kick = wp.vec3(0.0, 0.0, -0.04)

    def run(module: object, launch: Callable[..., None]) -> None:
        counts = [ByPart.rows(body.clamped), ByPart.rows(body.quarantined)]
        if module is particles:
            counts = [own[0] for own in counts]
        motion = [body.velocity, body.velocity_free]
        launch(module.fall_freely, kick, *motion, counts[1])  # type: ignore[attr-defined]
        moved = [body.velocity, body.position, body.speed_limit]
        launch(module.move, STEP, *moved, *counts)  # type: ignore[attr-defined]

    compare(
        pressed,
        lambda: run(particles, body.launch),
        lambda: run(particles_cpu, body.launch_blocks),
        [body.position, body.velocity, body.clamped, body.quarantined],
        per_particle(body.position, body.velocity, body.velocity_free)
        | over_parts(body.clamped, body.quarantined),
        tolerance=1e-6,
    )
    body.velocity.assign(kept)


def test_tangent_is_symmetric_and_positive(pressed: PlasticBonds):
    """Give a symmetric, positive definite system: what conjugate gradients ask for."""
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
    # Rows that are too short keep any of the neighbors.
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
