# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver as a whole: reproducibility, what it builds and what it refuses."""

import re
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp

from tactile_clay.solver import Material, MeshCollider, Scene, Settings, Solver
from tactile_clay.solver.plastic_bonds.model import PlasticBonds
from tactile_clay.tests.experiments.shapes import at, ball, block

SPACING = 0.005


def pressed_scene() -> tuple[Scene, object]:
    """A block, a table and a ball above it."""
    scene = Scene(SPACING)
    scene.add_clay(block(5, SPACING), Material())
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 0.037))
    return scene, tool


def press_on(solver: Solver, tool, frames: range) -> None:
    """Push the ball down by half a millimeter per frame."""
    for frame in frames:
        tool.set_pose(at(0.0002 * frame, 0, 0.037 - 0.0005 * frame))
        solver.step(1 / 60)


def test_same_steps_give_the_same_bits():
    """Repeat a run exactly."""
    results = []
    for _ in range(2):
        scene, tool = pressed_scene()
        solver = Solver(scene)
        press_on(solver, tool, range(12))
        results.append((solver.positions(), solver.velocities()))
    np.testing.assert_array_equal(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1], results[1][1])


def test_snapshot_restores_exactly_into_a_new_solver(tmp_path):
    """Continue from a saved and loaded snapshot with the same bits as an uninterrupted run."""
    scene, tool = pressed_scene()
    solver = Solver(scene)
    press_on(solver, tool, range(9))
    state: dict[str, Any] = dict(solver.snapshot())
    np.savez(tmp_path / "state.npz", **state)
    press_on(solver, tool, range(9, 20))

    scene, tool = pressed_scene()
    resumed = Solver(scene)
    with np.load(tmp_path / "state.npz") as state:
        resumed.restore(dict(state))
    press_on(resumed, tool, range(9, 20))
    np.testing.assert_array_equal(resumed.positions(), solver.positions())
    np.testing.assert_array_equal(resumed.velocities(), solver.velocities())
    assert resumed.diagnostics() == solver.diagnostics()


@pytest.mark.parametrize("stop", [2, 5, 8])
def test_snapshot_with_a_deforming_mesh_restores_exactly(stop: int):
    """Find the very same faces of a mesh that has changed its shape since the solver began."""
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=0.045)

    def begun() -> tuple[Solver, MeshCollider]:
        scene = Scene(spacing=0.01)
        grid = np.stack(np.meshgrid(*[np.arange(-3, 4) * 0.01] * 3), -1).reshape(-1, 3)
        scene.add_clay(grid + np.array([0.0, 0.0, 0.08]), Material.preset("plasticine"))
        collider = scene.add_mesh(sphere.vertices, sphere.faces)
        solver = Solver(scene)
        solver.begin()
        return solver, collider

    def go_on(solver: Solver, collider: MeshCollider, steps: range) -> None:
        for number in steps:
            swell = 1.0 + 0.01 * (number + 1)
            collider.set_vertices(sphere.vertices * (1.0, 1.0, swell))
            solver.step(1 / 60)

    solver, collider = begun()
    go_on(solver, collider, range(stop))
    state = solver.snapshot()
    go_on(solver, collider, range(stop, 14))
    resumed, collider = begun()
    resumed.restore(state)
    go_on(resumed, collider, range(stop, 14))
    np.testing.assert_array_equal(resumed.positions(), solver.positions())
    np.testing.assert_array_equal(resumed.velocities(), solver.velocities())


def test_snapshot_of_another_scene_is_refused():
    """Refuse a snapshot with other parts or sizes, and change nothing."""
    scene, _ = pressed_scene()
    solver = Solver(scene)
    before = solver.positions()
    bare = Scene(SPACING)
    bare.add_clay(block(5, SPACING), Material())
    with pytest.raises(ValueError, match="other parts"):
        solver.restore(Solver(bare).snapshot())
    state = solver.snapshot()
    state["position"] = state["position"][:-1]
    with pytest.raises(ValueError, match="another scene"):
        solver.restore(state)
    state = solver.snapshot()
    state["velocity"] = state["velocity"][:10]
    with pytest.raises(ValueError, match="velocity"):
        solver.restore(state)
    np.testing.assert_array_equal(solver.positions(), before)


def test_only_what_the_scene_holds_is_built():
    """List contact only if there are colliders, and bonds only if they are in use."""
    scene = Scene(SPACING)
    scene.add_clay(block(3, SPACING), Material())
    text = Solver(scene).describe()
    assert "contact" not in text
    fluid = Solver(scene, Settings(elastoplasticity=False)).describe()
    assert "bonds" not in fluid.replace("plastic_bonds", "")
    full, _ = pressed_scene()
    assert "1 meshes" in Solver(full).describe()
    assert "1 planes" in Solver(full).describe()


def test_reported_memory_covers_all_arrays():
    """Count arrays in structs too: rows of neighbors are most of a scene's memory."""
    scene = Scene(SPACING)
    scene.add_clay(block(8, SPACING), Material())
    solver = Solver(scene)
    reported = float(re.findall(r"([0-9.]+) MB", solver.describe())[0])
    model = solver._model
    assert isinstance(model, PlasticBonds)
    rows = model.pairs.rows
    held = sum(value.capacity for value in vars(rows).values() if isinstance(value, wp.array))
    assert held > 0.5e6
    assert reported > held / 1e6


def test_empty_scene_steps():
    """Advance time without any clay."""
    solver = Solver(Scene())
    solver.step(0.5)
    assert solver.time == 0.5
    assert solver.positions().shape == (0, 3)
    assert solver.diagnostics().particle_count == 0


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_particles_fall_freely(count: int):
    """Let one, two or three particles fall freely."""
    scene = Scene(SPACING)
    scene.add_clay(block(3, SPACING)[:count], Material())
    solver = Solver(scene)
    before = solver.positions()[:, 2].astype(float)
    solver.step(0.1)
    fallen = before - solver.positions()[:, 2]
    assert fallen == pytest.approx(0.5 * 9.81 * 0.1**2, rel=1e-4)


@pytest.mark.parametrize("duration", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_duration_is_refused(duration: float):
    """Refuse a step whose duration is not a positive number."""
    with pytest.raises(ValueError, match="above 0"):
        Solver(Scene()).step(duration)


def test_unknown_device_and_model_are_refused():
    """List the available devices and models."""
    with pytest.raises(ValueError, match="cpu"):
        Solver(Scene(), device="abacus")
    with pytest.raises(ValueError, match="plastic_bonds"):
        Settings(model="blancmange")
    with pytest.raises(ValueError, match="substeps"):
        Settings(substeps=0)


def test_force_on_an_unknown_collider_is_refused():
    """Refuse a collider of another scene."""
    scene, _ = pressed_scene()
    with pytest.raises(ValueError, match="not in the scene"):
        Solver(scene).force_on(Scene().add_plane())


def test_a_non_finite_particle_is_held_and_counted():
    """Hold a particle whose state becomes non-finite; the rest continues and stays finite."""
    scene, _ = pressed_scene()
    solver = Solver(scene)
    solver.step(1 / 60)
    state = solver.snapshot()
    state["velocity"][7] = np.nan
    solver.restore(state)
    for _ in range(5):
        solver.step(1 / 60)
    assert np.isfinite(solver.positions()).all()
    assert np.isfinite(solver.velocities()).all()
    assert solver.diagnostics().quarantined >= 1


def test_longer_steps_take_more_substeps():
    """Keep the length of substeps in long steps, so that clay at rest stays put."""
    scene = Scene(SPACING)
    scene.add_clay(block(5, SPACING), Material())
    scene.add_plane()
    solver = Solver(scene)
    start = solver.positions()
    for _ in range(5):
        solver.step(0.1)
    assert solver.diagnostics().substeps == 6 * Settings().substeps
    assert np.abs(solver.positions() - start).max() < 0.2 * SPACING


def test_colors_come_back_in_order():
    """Return colors in the order added."""
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    scene = Scene(SPACING)
    scene.add_clay_mesh(box.vertices, box.faces, Material(), color=(1, 0, 0, 1))
    scene.add_clay_mesh(
        box.vertices + np.array((0.1, 0, 0)), box.faces, Material(), color=(0, 0, 1, 1)
    )
    colors = Solver(scene).colors()
    assert colors.shape == (128, 4)
    assert colors[0].tolist() == [1, 0, 0, 1]
    assert colors[-1].tolist() == [0, 0, 1, 1]


@pytest.mark.parametrize("distance", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("turned", [False, True])
def test_a_pose_set_before_the_first_step_is_where_a_tool_begins(distance: float, turned: bool):
    """Do not sweep a tool from the identity to its first pose, nor count that as a jump."""
    scene = Scene(0.005)
    scene.add_clay(block(6, 0.005), Material())
    scene.add_plane()
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(-distance, 0, 0.015))
    solver = Solver(scene)
    before = solver.positions()
    pose = at(distance, 0, 0.015)
    if turned:
        pose = pose @ np.diag((1.0, -1.0, -1.0, 1.0))
    if distance < 0.03:
        pose[2, 3] = 0.05
    tool.set_pose(pose)
    for _ in range(5):
        solver.step(1 / 60)
    assert np.abs(solver.positions() - before).max() < 0.1 * 0.005
    assert not solver.force_on(tool).any()
    assert solver.diagnostics().teleported == 0


def test_begin_makes_the_next_pose_a_motion():
    """After `begin`, sweep from where a tool was when the solver was made."""
    forces = []
    for begins in (False, True):
        scene = Scene(0.005)
        scene.add_clay(block(6, 0.005), Material())
        scene.add_plane()
        sphere = ball(0.01)
        tool = scene.add_mesh(sphere.vertices, sphere.faces)
        tool.set_pose(at(0, 0, 0.0405))
        solver = Solver(scene)
        if begins:
            solver.begin()
        tool.set_pose(at(0, 0, 0.0385))
        solver.step(1 / 60)
        forces.append(solver.diagnostics().max_speed)
    assert forces[1] > 2.0 * forces[0]
