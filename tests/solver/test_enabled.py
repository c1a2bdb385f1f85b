# SPDX-License-Identifier: GPL-3.0-or-later
"""Mesh colliders that are disabled and enabled again."""

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Material, MeshCollider, Scene, Settings, Solver
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005


def _block_with_ball(
    *, model: str = "plastic_bonds", ball_too: bool = True
) -> tuple[Solver, MeshCollider | None]:
    scene = Scene(SPACING)
    scene.add_clay(block(5, SPACING), Material())
    scene.add_plane()
    sphere = ball(0.008)
    tool = scene.add_mesh(sphere.vertices, sphere.faces) if ball_too else None
    if tool:
        tool.set_pose(at(0, 0, 0.2))
    return Solver(scene, Settings(model=model)), tool


@pytest.mark.parametrize("model", ["plastic_bonds", "paper"])
def test_disabled_tool_passes_through_clay_without_effect(model: str):
    """Yield the same bits and substeps as without the tool, and no force, depth or jump."""
    alone, _ = _block_with_ball(model=model, ball_too=False)
    solver, tool = _block_with_ball(model=model)
    assert tool is not None
    tool.set_enabled(False)
    for step in range(12):
        tool.set_pose(at(0.004 * step - 0.02, 0, 0.012))
        for each in (alone, solver):
            each.step(1 / 60)
        assert not solver.force_on(tool).any()
    np.testing.assert_array_equal(solver.positions(), alone.positions())
    said, expected = solver.diagnostics(), alone.diagnostics()
    assert said.teleported == 0
    assert said.substeps == expected.substeps
    assert said.max_penetration == expected.max_penetration


def test_enabled_tool_appears_at_its_pose_and_clay_moves_out_gently():
    """Neither sweep from where it was disabled nor count that as a jump."""
    solver, tool = _block_with_ball()
    assert tool is not None
    tool.set_enabled(False)
    tool.set_pose(at(-0.1, 0, 0.012))
    solver.step(1 / 60)
    before = solver.positions()
    tool.set_pose(at(0.012, 0, 0.012))
    tool.set_enabled(True)
    fastest = 0.0
    for _ in range(30):
        solver.step(1 / 60)
        fastest = max(fastest, solver.diagnostics().max_speed)
    after = solver.positions()
    assert np.linalg.norm(after - (0.012, 0, 0.012), axis=1).min() > 0.0079
    assert (after - before)[:, 0].mean() < -0.2 * SPACING
    assert solver.diagnostics().teleported == 0
    assert fastest < 1.0


def test_sleeping_clay_falls_when_its_support_is_disabled():
    """Wake clay that lies on a mesh, and let it fall to the floor below."""
    scene = Scene(SPACING)
    scene.add_clay(block(4, SPACING, (0, 0, 0.05)), Material())
    scene.add_plane()
    box = trimesh.creation.box((0.1, 0.1, 0.02))
    shelf = scene.add_mesh(box.vertices, box.faces)
    shelf.set_pose(at(0, 0, 0.04))
    solver = Solver(scene)
    for _ in range(90):
        solver.step(1 / 60)
    assert solver.diagnostics().awake == 0
    assert solver.force_on(shelf)[2] < 0
    shelf.set_enabled(False)
    for _ in range(30):
        solver.step(1 / 60)
    assert solver.positions()[:, 2].min() == pytest.approx(0.5 * SPACING, abs=0.05 * SPACING)
    assert not solver.force_on(shelf).any()


def test_disabled_tool_ignores_clay_woken_by_another():
    """Touch no clay that wakes around a tool disabled while the clay slept."""
    scene = Scene(SPACING)
    scene.add_clay(block(5, SPACING), Material())
    scene.add_plane()
    sphere = ball(0.006)
    disabled, other = (scene.add_mesh(sphere.vertices, sphere.faces) for _ in range(2))
    other.set_pose(at(0, 0, 0.2))
    disabled.set_enabled(False)
    disabled.set_pose(at(0, 0, 0.012))
    solver = Solver(scene)
    for _ in range(90):
        solver.step(1 / 60)
    assert solver.diagnostics().awake == 0
    other.set_pose(at(0.1, 0, 0.012))
    solver.step(1 / 60)
    for step in range(8):
        other.set_pose(at(0.03 - 0.001 * step, 0, 0.012))
        solver.step(1 / 60)
        assert not solver.force_on(disabled).any()
    assert solver.diagnostics().awake == 125
    assert solver.diagnostics().max_penetration < 0.1 * SPACING


@pytest.mark.parametrize("disabled", [True, False])
def test_snapshot_keeps_whether_a_tool_is_enabled(disabled: bool):
    """Continue with the same bits in a new solver, also across a change."""
    states = []
    snapshot = None
    for fresh in (False, True):
        solver, tool = _block_with_ball()
        assert tool is not None
        if not fresh:
            for step in range(6):
                tool.set_pose(at(0.03 - 0.002 * step, 0, 0.012))
                tool.set_enabled(step != 3 and not (step > 3 and disabled))
                solver.step(1 / 60)
            snapshot = solver.snapshot()
        else:
            assert snapshot is not None
            tool.set_pose(at(0.02, 0, 0.012))
            tool.set_enabled(not disabled)
            solver.restore(snapshot)
        for step in range(6, 10):
            tool.set_pose(at(0.03 - 0.002 * step, 0, 0.012))
            tool.set_enabled(step > 7 or not disabled)
            solver.step(1 / 60)
        states.append(solver.positions())
    np.testing.assert_array_equal(states[0], states[1])
