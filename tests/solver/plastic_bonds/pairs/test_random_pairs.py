# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes for the CPU's vector units against the plain kernels, from random states.

The states are more extreme than real ones, so that every branch of the law is taken.
"""

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.solver.plastic_bonds.model import PlasticBonds
from tactile_clay.solver.plastic_bonds.pairs import (
    forces,
    forces_cpu,
    measures,
    measures_cpu,
    products,
    products_cpu,
    rows,
)
from tactile_clay.tests.experiments.shapes import block
from tactile_clay.tests.solver.plastic_bonds.two_ways import (
    acting,
    compare,
    conditions,
    over_parts,
    per_particle,
)

SPACING = 0.005
MATERIALS = (
    Material(),
    Material(yield_stress=2e3, density=1200.0, shear_modulus=5e4, flow_index=0.5),
    Material(yield_stress=8e3, density=1900.0, viscosity=0.0, cohesion=3e4),
)
SEEDS = (1, 2, 3)
GATHER = (measures.gather_pairs, measures_cpu.gather_pairs)
MEASURE = (measures.measure_pairs, measures_cpu.measure_pairs)
SUM_FORCES = (forces.sum_forces, forces_cpu.sum_forces)
FLOW = (forces.flow_pairs, forces_cpu.flow_pairs)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param((seed, count, bonds), id=f"{count} of clay, {kind}, {seed}")
        for count in (1, 3)
        for bonds, kind in ((True, "bonds"), (False, "no bonds"))
        for seed in SEEDS
    ],
)
def model(request: pytest.FixtureRequest) -> PlasticBonds:
    """Scatter particles, velocities and rest lengths; some particles sleep, two coincide."""
    seed, count, bonds = request.param
    random = np.random.default_rng(seed)
    scene = Scene(SPACING)
    points = block((9, 7, 6), SPACING)
    points += random.normal(scale=0.15 * SPACING, size=points.shape)
    points[5] = points[6]
    kind = random.integers(count, size=len(points))
    for index in range(count):
        scene.add_clay(points[kind == index], MATERIALS[index])
    model = Solver(scene, Settings(elastoplasticity=bonds))._model
    assert isinstance(model, PlasticBonds)
    body, table = model.particles, model.pairs.rows
    place = body.position.numpy()
    # From nearly still on one side to violent on the other.
    wildness = 10.0 ** (-4.0 * (place[:, 0].max() - place[:, 0]) / np.ptp(place[:, 0]))
    for velocity in (body.velocity, body.velocity_free):
        drawn = random.normal(scale=0.3, size=place.shape) * wildness[:, None]
        velocity.assign(drawn.astype(np.float32))
    body.resting.assign((random.uniform(size=body.count) < 0.1).astype(np.int32))
    first, listed, other = table.first.numpy(), table.listed.numpy(), table.other.numpy()
    acts = random.integers(listed // 2, listed + 1)
    table.acting.assign(acts.astype(np.int32))
    # Free pairs, pairs about to bond, and bonds of all lengths up to broken ones.
    rest = np.zeros(table.rest_length.shape, np.float32)
    for i, wild in enumerate(wildness):
        slots = slice(first[i], first[i] + acts[i])
        apart = np.linalg.norm(place[other[slots]] - place[i], axis=1)
        drawn = random.uniform(0.5, 2.0, acts[i]) * SPACING
        bonded = random.uniform(size=acts[i]) < (0.7 if bonds else 0.0)
        waiting = -random.integers(1, 4, acts[i])
        rest[slots] = np.where(bonded, apart + wild * (drawn - apart), waiting)
    table.rest_length.assign(rest)
    body.launch(
        measures.gather_pairs,
        model.shared_law,
        model.particle_laws,
        body.material,
        body.position,
        body.velocity,
        table,
    )
    return model


def both_ways(
    model: PlasticBonds, kernels: tuple[wp.Kernel, wp.Kernel], *inputs: object
) -> tuple[Callable[[], None], Callable[[], None]]:
    """A pass over the rows, with the plain kernel and with vector units."""
    body = model.particles
    plain, by_block = kernels
    left = [model.pairs._left] if kernels is GATHER else []
    return (
        lambda: body.launch(plain, *inputs),
        lambda: body.launch_blocks(by_block, *inputs, *left),
    )


def test_states_take_every_branch(model: PlasticBonds):
    """Contain compressed and flowing particles, and bonds of every length."""
    condition = model.pairs.rows.condition.numpy()
    assert (condition[:, rows.COMPRESSION] > 0).any()
    assert (condition[:, rows.DAMPING] > 0).any()
    rest = acting(model, "rest_length")() / SPACING
    assert (rest < 0).any()
    if rest.max() > 0:
        assert (condition[:, rows.COMPRESSION] == 0).any()
        assert condition[:, rows.SHARE].min() == 0
        assert condition[:, rows.SHARE].max() > 0.5
        assert condition[:, rows.DILATION].min() < 0 < condition[:, rows.DILATION].max()
        assert ((rest > 0) & (rest < 0.6)).any()
        assert (rest > 1.9).any()


def test_pairs_are_gathered_the_same(model: PlasticBonds):
    """Find the same pairs, directions, distances and conditions."""
    table, body = model.pairs.rows, model.particles
    motion = [body.position, body.velocity, table]
    names = ("direction_x", "direction_y", "direction_z", "distance", "other", "rest_length")
    compare(
        model,
        *both_ways(model, GATHER, model.shared_law, model.particle_laws, body.material, *motion),
        [table.other, table.rest_length, table.acting],
        {name: acting(model, name) for name in names}
        | conditions(model)
        | per_particle(table.acting),
        tolerance=2e-5,
        allow_zero=True,
    )


def test_pairs_are_measured_the_same(model: PlasticBonds):
    """Measure the same lengths and conditions."""
    body = model.particles
    inputs = [model.shared_law, model.particle_laws, body.material, body.velocity]
    compare(
        model,
        *both_ways(model, MEASURE, *inputs, model.pairs.rows),
        [],
        {"distance_next": acting(model, "distance_next")} | conditions(model),
        tolerance=2e-5,
        allow_zero=True,
    )


def test_forces_are_the_same(model: PlasticBonds):
    """Sum the same forces and tangents."""
    body, table, solve = model.particles, model.pairs.rows, model.gradients.data
    laws = [model.shared_law, model.pair_laws, model.particle_laws]
    motion = [body.material, body.velocity_free, body.velocity]
    compare(
        model,
        *both_ways(model, SUM_FORCES, *laws, *motion, table, solve.residual, model.diagonal),
        [],
        {name: acting(model, name) for name in ("stiffness", "slope")}
        | per_particle(solve.residual, model.diagonal),
        tolerance=2e-5,
    )


def test_products_are_the_same(model: PlasticBonds):
    """Compute the same product with any direction."""
    body, solve, law = model.particles, model.gradients.data, model.shared_law
    direction = np.random.default_rng(4).normal(size=(body.count, 4))
    direction[:, 3] = 0.0
    solve.direction.assign(direction.astype(np.float32))

    def multiply(press: object, multiply: object, launch: Callable[..., None]) -> None:
        solve.curvature.zero_()
        table, laws = model.pairs.rows, model.particle_laws
        launch(press, law, laws, body.material, table, solve.direction)
        inputs = [law, table, model.own_block, solve.direction, solve.product]
        launch(multiply, *inputs, solve.curvature, 0)

    plain, by_block = products, products_cpu
    compare(
        model,
        lambda: multiply(plain.press_pairs, plain.multiply_pairs, body.launch),
        lambda: multiply(by_block.press_pairs, by_block.multiply_pairs, body.launch_blocks),
        [solve.direction],
        per_particle(solve.direction, solve.product) | over_parts(solve.curvature),
        tolerance=2e-5,
    )


def test_bonds_flow_the_same(model: PlasticBonds):
    """Flow to the same rest lengths, and break the same bonds."""
    body, table = model.particles, model.pairs.rows
    inputs = [model.shared_law, model.pair_laws, body.material, body.velocity, table]
    compare(
        model,
        *both_ways(model, FLOW, *inputs),
        [table.rest_length],
        {"rest_length": acting(model, "rest_length")},
        tolerance=2e-5,
        allow_zero=True,
    )
