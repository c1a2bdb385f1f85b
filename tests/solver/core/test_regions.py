# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of clay that sleep, and what wakes them."""

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.solver.scene.scene import MeshCollider, Plane
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005
SLAB = (48, 24, 8)


def slab(settings: Settings | None = None) -> tuple[Solver, Plane, MeshCollider]:
    """A slab at rest on a table, with a ball above one end."""
    scene = Scene(SPACING)
    scene.add_clay(block(SLAB, SPACING), Material())
    table = scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0.09, 0, 0.07))
    solver = Solver(scene, settings)
    for _ in range(60):
        solver.step(1 / 60)
    return solver, table, tool


def poke(solver: Solver, tool: MeshCollider) -> list[int]:
    """Poke one end and take the ball away; return how many were awake after each step."""
    awake = []
    for height in (*np.linspace(0.054, 0.044, 10), *np.linspace(0.046, 0.08, 10)):
        tool.set_pose(at(0.09, 0, height))
        solver.step(1 / 60)
        awake.append(solver.diagnostics().awake)
    return awake


def weight(solver: Solver) -> float:
    return solver.scene.particle_count * Material().density * SPACING**3 * 9.81


@pytest.fixture(scope="module")
def poked() -> tuple[Solver, list[int], np.ndarray]:
    """A poked slab at rest again, how many were awake, and the slab before."""
    solver, _, tool = slab()
    before = solver.positions()
    awake = [solver.diagnostics().awake, *poke(solver, tool)]
    for _ in range(90):
        solver.step(1 / 60)
    awake.append(solver.diagnostics().awake)
    return solver, awake, before


def test_clay_at_rest_sleeps_and_weighs_the_same():
    """Sleep when at rest, and keep pressing on the table with the whole weight."""
    solver, table, _ = slab()
    assert solver.diagnostics().awake == 0
    before = solver.positions()
    for _ in range(1000):
        solver.step(1 / 60)
    np.testing.assert_array_equal(solver.positions(), before)
    np.testing.assert_array_equal(solver.velocities(), 0.0)
    assert -solver.force_on(table)[2] == pytest.approx(weight(solver), rel=1e-3)


def test_a_poke_wakes_only_its_surroundings(poked: tuple[Solver, list[int], np.ndarray]):
    """Wake the end that is poked, not the other, and let it sleep again."""
    solver, awake, before = poked
    assert awake[0] == 0
    assert 0 < max(awake) < 0.7 * solver.scene.particle_count
    assert awake[-1] == 0
    moved = np.linalg.norm(solver.positions() - before, axis=1)
    assert moved.max() > 0.5 * SPACING
    assert moved[before[:, 0] < -0.04].max() == 0.0


def test_a_dent_is_the_same_beside_sleeping_clay(poked: tuple[Solver, list[int], np.ndarray]):
    """Leave the same dent as in clay that is awake throughout, without a seam."""
    solver, _, before = poked
    awake, _, tool = slab(Settings(sleeping=False))
    start = awake.positions()
    poke(awake, tool)
    for _ in range(60):
        awake.step(1 / 60)
    dent, expected = solver.positions() - before, awake.positions() - start
    difference = np.linalg.norm(dent - expected, axis=1)
    assert np.sqrt(np.mean(difference**2)) < 0.03 * SPACING
    assert abs(dent[:, 2].min() - expected[:, 2].min()) < 0.15 * SPACING


@pytest.mark.parametrize("count", [5, 14])
def test_clay_wakes_when_its_support_is_removed(count: int):
    """Let all clay fall within a frame after the support of sleeping clay is removed."""
    scene = Scene(SPACING)
    scene.add_clay(block(count, SPACING, (0, 0, 0.1)), Material())
    plate = trimesh.creation.box((0.2, 0.2, 0.02))
    tool = scene.add_mesh(plate.vertices, plate.faces)
    tool.set_pose(at(0, 0, 0.09))
    solver = Solver(scene)
    for _ in range(240):
        solver.step(1 / 60)
        if solver.diagnostics().awake == 0:
            break
    assert solver.diagnostics().awake == 0
    tool.set_pose(at(0, 0, -0.5))
    height = solver.positions()[:, 2]
    for _ in range(12):
        solver.step(1 / 60)
    fallen = height - solver.positions()[:, 2]
    assert fallen.min() > 0.97 * 0.5 * 9.81 * (11 / 60) ** 2
    assert fallen.max() < 1.03 * 0.5 * 9.81 * (12 / 60) ** 2


def test_floating_clay_wakes_when_it_is_pushed():
    """Move the whole of a sleeping weightless block when its end is pushed, not just dent it."""
    scene = Scene(SPACING, gravity=(0.0, 0.0, 0.0))
    scene.add_clay(block((20, 5, 5), SPACING), Material())
    plate = trimesh.creation.box((0.02, 0.1, 0.1))
    tool = scene.add_mesh(plate.vertices, plate.faces)
    tool.set_pose(at(-0.0605, 0, 0.0125))
    solver = Solver(scene)
    for _ in range(60):
        solver.step(1 / 60)
    assert solver.diagnostics().awake == 0
    for frame in range(30):
        tool.set_pose(at(-0.0605 + 0.0005 * frame, 0, 0.0125))
        solver.step(1 / 60)
    moved = (solver.positions() - scene.initial_positions())[:, 0]
    assert moved.min() > 0.8 * moved.max() > 0.008


def test_falling_clay_wakes_what_it_falls_on():
    """Wake sleeping clay when other clay falls on it, and carry the weight of both."""
    scene = Scene(SPACING)
    scene.add_clay(block((10, 10, 6), SPACING), Material())
    scene.add_clay(block(4, SPACING, (0, 0, 0.3)), Material(), velocities=(0, 0, 2.5))
    table = scene.add_plane()
    solver = Solver(scene)
    slept = False
    for _ in range(90):
        solver.step(1 / 60)
        slept |= solver.diagnostics().awake <= 64
    assert slept
    for _ in range(30):
        solver.step(1 / 60)
    assert -solver.force_on(table)[2] == pytest.approx(weight(solver), rel=0.01)
    assert solver.positions()[600:, 2].min() > 0.02


def test_sleep_survives_a_snapshot():
    """Restore sleeping clay asleep; the same steps then give the same bits."""
    solver, table, tool = slab()
    state = solver.snapshot()
    results = []
    for _ in range(2):
        for height in np.linspace(0.054, 0.048, 6):
            tool.set_pose(at(0.09, 0, height))
            solver.step(1 / 60)
        results.append((solver.positions(), solver.force_on(table)))
        solver.restore(state)
        assert solver.diagnostics().awake == 0
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)
