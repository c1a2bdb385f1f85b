# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact with meshes that move, rotate, scale, deform and jump."""

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005


def test_block_rests_on_a_mesh_and_weighs_m_g():
    """Weigh m g on a box just as on a plane."""
    scene = Scene(SPACING)
    scene.add_clay(block(5, SPACING, (0.001, 0.002, 0.02)), Material())
    box = trimesh.creation.box((0.2, 0.2, 0.04))
    table = scene.add_mesh(box.vertices, box.faces)
    solver = Solver(scene)
    for _ in range(45):
        solver.step(1 / 60)
    force = np.zeros(3)
    for _ in range(30):
        solver.step(1 / 60)
        force += solver.force_on(table) / 30
    weight = 125 * 1700 * SPACING**3 * 9.81
    assert force[2] == pytest.approx(-weight, rel=0.01)
    assert np.abs(force[:2]).max() < 0.01 * weight


@pytest.mark.parametrize("scale", [(1.0, 1.0, 0.5), (-1.0, 1.0, 0.5), (2.0, 0.5, 0.5)])
def test_scale_and_mirroring_of_a_tool_apply(scale: tuple[float, float, float]):
    """Rest on the actual top of a scaled, mirrored box."""
    scene = Scene(SPACING)
    scene.add_clay(block(4, SPACING, (0, 0, 0.012)), Material())
    box = trimesh.creation.box((0.1, 0.1, 0.04))
    tool = scene.add_mesh(box.vertices, box.faces)
    tool.set_pose(np.diag([*scale, 1.0]))
    solver = Solver(scene)
    for _ in range(60):
        solver.step(1 / 60)
    lowest = solver.positions()[:, 2].min() - 0.5 * SPACING
    assert lowest == pytest.approx(0.02 * scale[2], abs=2e-4)


def test_moving_floor_carries_its_block():
    """Carry a block along by friction, without slip."""
    scene = Scene(SPACING)
    scene.add_clay(block(4, SPACING, (0, 0, 0.02)), Material())
    box = trimesh.creation.box((0.2, 0.2, 0.04))
    belt = scene.add_mesh(box.vertices, box.faces)
    solver = Solver(scene)
    x = 0.0
    for frame in range(60):
        x += 0.05 / 60 * min(1.0, frame / 20)
        belt.set_pose(at(x, 0, 0))
        solver.step(1 / 60)
    assert solver.positions()[:, 0].mean() == pytest.approx(x, abs=5e-4)


def test_turning_floor_carries_its_block_round():
    """Rotate a block with a turntable."""
    scene = Scene(SPACING)
    scene.add_clay(block(4, SPACING, (0, 0, 0.02)), Material())
    box = trimesh.creation.box((0.2, 0.2, 0.04))
    table = scene.add_mesh(box.vertices, box.faces)
    solver = Solver(scene)
    start = solver.positions().astype(float)
    angle = 0.0
    for frame in range(60):
        angle += 1.0 / 60 * min(1.0, frame / 20)
        table.set_pose(trimesh.transformations.rotation_matrix(angle, (0, 0, 1)))
        solver.step(1 / 60)
    now = solver.positions().astype(float)
    cross = np.cross(start, now)[:, 2].sum()
    dot = (start[:, :2] * now[:, :2]).sum()
    assert np.arctan2(cross, dot) == pytest.approx(angle, rel=0.03)


def test_deforming_mesh_pushes_clay():
    """Push clay with moving vertices, and report the force."""
    scene = Scene(SPACING, gravity=(0, 0, 0))
    scene.add_clay(block(4, SPACING, (0.03, 0, -0.01)), Material())
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    solver = Solver(scene)
    force = 0.0
    for frame in range(1, 31):
        tool.set_vertices(sphere.vertices * (1 + 0.05 * frame))
        solver.step(1 / 60)
        force = min(force, solver.force_on(tool)[0])
    gap = np.linalg.norm(solver.positions(), axis=1).min() - 0.025 - 0.5 * SPACING
    assert force < 0
    assert gap > -0.05 * SPACING


@pytest.mark.parametrize("speed", [0.5, 2.0])
def test_fast_tool_does_not_tunnel(speed: float):
    """Sweep a ball through a block; nothing stays inside it or flies off faster."""
    scene = Scene(SPACING)
    scene.add_clay(block(8, SPACING), Material())
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(-0.05, 0, 0.02))
    solver = Solver(scene)
    fastest = 0.0
    x = -0.05
    while x < 0.0:
        x = min(x + speed / 60, 0.0)
        tool.set_pose(at(x, 0, 0.02))
        solver.step(1 / 60)
        fastest = max(fastest, solver.diagnostics().max_speed)
        inside = np.linalg.norm(solver.positions() - (x, 0, 0.02), axis=1) < 0.01
        assert not inside.any()
    assert solver.diagnostics().teleported == 0
    assert fastest < 2.0 * speed


def test_tool_that_jumps_inside_moves_clay_out_gently():
    """Push clay out of a tool that jumped into it, slowly."""
    scene = Scene(SPACING)
    scene.add_clay(block(8, SPACING), Material())
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 1.0))
    solver = Solver(scene)
    solver.step(1 / 60)
    tool.set_pose(at(0, 0, 0.03))
    fastest = 0.0
    for _ in range(60):
        solver.step(1 / 60)
        fastest = max(fastest, solver.diagnostics().max_speed)
    assert solver.diagnostics().teleported == 1
    assert fastest < 2.0
    inside = np.linalg.norm(solver.positions() - (0, 0, 0.03), axis=1) < 0.0105
    assert not inside.any()


def test_tool_far_away_costs_no_queries_and_changes_nothing():
    """Yield the same bits with a tool that never comes near."""
    results = []
    for with_tool in (False, True):
        scene = Scene(SPACING)
        scene.add_clay(block(4, SPACING), Material())
        scene.add_plane()
        if with_tool:
            sphere = ball(0.01)
            scene.add_mesh(sphere.vertices + np.array((0.5, 0, 0)), sphere.faces)
        solver = Solver(scene)
        for _ in range(10):
            solver.step(1 / 60)
        results.append(solver.positions())
    np.testing.assert_array_equal(results[0], results[1])


def test_fast_tool_far_from_the_clay_takes_no_more_substeps():
    """Add no substeps while a tool moves fast elsewhere, and sweep when it comes near."""
    scene = Scene(SPACING)
    scene.add_clay(block(4, SPACING), Material())
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0.5, 0, 0.3))
    solver = Solver(scene)
    tool.set_pose(at(0.5, 0, 0.26))
    solver.step(1 / 60)
    assert solver.diagnostics().substeps == solver.settings.substeps
    tool.set_pose(at(0.05, 0, 0.01))
    solver.step(1 / 60)
    tool.set_pose(at(0.02, 0, 0.01))
    solver.step(1 / 60)
    assert solver.diagnostics().substeps in (24, 25)
