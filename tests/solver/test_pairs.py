# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes over pairs: the vectorised rows against the plain kernels, and the tangent."""

from typing import Any

import numpy as np
import pytest
import warp as wp

from tactile_clay.solver import Material, Scene, Solver, pair_rows, pair_rows_cpu
from tactile_clay.solver.plastic_bonds import PlasticBonds
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005


@pytest.fixture(scope="module")
def pressed() -> PlasticBonds:
    """Clay in the middle of a press: compressed, stretched and yielding."""
    scene = Scene(SPACING)
    points = block(7, SPACING)
    points += np.random.default_rng(1).uniform(-0.1, 0.1, points.shape) * SPACING
    scene.add_clay(points, Material())
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 0.047))
    solver = Solver(scene)
    for frame in range(10):
        tool.set_pose(at(0, 0, 0.047 - 0.001 * frame))
        solver.step(1 / 60)
    model = solver._model
    assert isinstance(model, PlasticBonds)
    assert model.compression().max() > 0
    return model


def launch(model: PlasticBonds, kernel: Any, *inputs: Any) -> None:
    """Run a kernel over all particles."""
    wp.launch(kernel, dim=model.particles.count, inputs=list(inputs), device="cpu")


def test_vectorised_measure_is_the_plain_one(pressed: PlasticBonds):
    """Measure the same lengths, stretches and compressions as the plain kernel."""
    rows = pressed.pairs.rows
    results = []
    for kernel in (pair_rows.measure_pairs, pair_rows_cpu.measure_pairs):
        launch(pressed, kernel, pressed.clay, pressed.particles.velocity, rows)
        count = rows.count.numpy()
        used = np.arange(rows.distance_next.shape[1]) < count[:, None]
        results.append(
            (
                rows.distance_next.numpy()[used].copy(),
                rows.mean_stretch.numpy().copy(),
                rows.compression.numpy().copy(),
            )
        )
    for plain, vectorised, scale in zip(*results, (SPACING, SPACING, 1.0), strict=True):
        np.testing.assert_allclose(vectorised, plain, atol=2e-6 * scale)


def test_vectorised_product_is_the_plain_one(pressed: PlasticBonds):
    """Multiply any direction to the same product as the plain kernels."""
    rows = pressed.pairs.rows
    count = pressed.particles.count
    direction = wp.array(
        np.random.default_rng(2).normal(size=(count, 3)), dtype=wp.vec3, device="cpu"
    )
    results = []
    for module in (pair_rows, pair_rows_cpu):
        pressure = wp.zeros(count, dtype=float, device="cpu")
        product = wp.zeros(count, dtype=wp.vec3, device="cpu")
        launch(
            pressed,
            module.press_pairs,
            pressed.bodies,
            pressed.particles.material,
            pressed.clay.time_step,
            rows,
            direction,
            pressure,
        )
        launch(
            pressed, module.multiply_pairs, rows, pressed.own_block, pressure, direction, product
        )
        results.append((pressure.numpy(), product.numpy()))
    for plain, vectorised in zip(*results, strict=True):
        assert np.abs(plain).max() > 0
        np.testing.assert_allclose(vectorised, plain, atol=1e-5 * np.abs(plain).max())


def test_tangent_is_symmetric_and_positive(pressed: PlasticBonds):
    """Give a symmetric, positive definite system: what conjugate gradients ask for."""
    rows = pressed.pairs.rows
    count = pressed.particles.count
    generator = np.random.default_rng(3)
    vectors = [generator.normal(size=(count, 3)).astype(np.float32) for _ in range(2)]
    products = []
    for vector in vectors:
        direction = wp.array(vector, dtype=wp.vec3, device="cpu")
        product = wp.zeros(count, dtype=wp.vec3, device="cpu")
        pressed.pairs.multiply(
            pressed.clay,
            pressed.bodies,
            pressed.particles.material,
            pressed.own_block,
            direction,
            wp.zeros(count, dtype=float, device="cpu"),
            product,
        )
        products.append(product.numpy().astype(float))
    assert rows.stiffness.numpy().max() > 0
    one_two = float((vectors[0] * products[1]).sum())
    two_one = float((vectors[1] * products[0]).sum())
    energy = float((vectors[0] * products[0]).sum())
    assert energy > 0
    assert one_two == pytest.approx(two_one, abs=1e-5 * energy)


def test_rest_lengths_are_equal_at_both_ends(pressed: PlasticBonds):
    """Keep the same rest length at both ends of every bond, to float32 rounding."""
    neighbors = pressed.neighbors
    count = neighbors.count.numpy()
    index, length = neighbors.index.numpy(), neighbors.rest_length.numpy()
    kept = {
        (i, int(index[i, s])): length[i, s]
        for i in range(len(count))
        for s in range(count[i])
        if length[i, s] > 0
    }
    assert len(kept) > 10 * len(count)
    worst = max(abs(value - kept.get((j, i), np.inf)) / SPACING for (i, j), value in kept.items())
    assert worst < 1e-4
