# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's clay as a whole."""

import math

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.tests.experiments.shapes import at, block
from tactile_clay.tests.experiments.standing import stand

SPACING = 0.005
PAPER = Settings(model="paper")


def pressed_scene() -> tuple[Scene, list]:
    """A block on a plane with a ball above it, and the ball's poses in six steps."""
    scene = Scene(SPACING)
    scene.add_clay(block((6, 6, 4), SPACING), Material())
    scene.add_plane()
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    scene.add_mesh(ball.vertices, ball.faces)
    scene.meshes[0].set_pose(at(0.001, 0, 0.0315))
    return scene, [at(0.001, 0.001 * k, 0.0315 - 0.002 * k) for k in range(1, 7)]


def test_block_at_rest_weighs_m_g_and_stays():
    """Weigh m g within a thousandth, and not move at all once it has settled."""
    result = stand(counts=6, settings=PAPER)
    assert result.normal_force == pytest.approx(1.0, abs=1e-3)
    assert result.drift < 1e-4 * SPACING
    assert result.kinetic_energy < 1e-10


def test_fall_is_that_of_algorithm_1():
    """Fall ½ g t² + ½ g t Δt, as position-based dynamics does, without distortion."""
    scene = Scene(SPACING)
    scene.add_clay(block(3, SPACING), Material())
    solver = Solver(scene, PAPER)
    before = solver.positions().astype(float)
    for _ in range(6):
        solver.step(1 / 60)
        assert solver.diagnostics().substeps == 8
    moved = solver.positions() - before
    expected = 0.5 * 9.81 * 0.1 * (0.1 + 1 / 480)
    assert -moved[:, 2] == pytest.approx(expected, rel=1e-4)


def test_spin_is_damped_as_position_based_dynamics_damps_it():
    """Keep linear momentum, and lose spin by ω0 / √(1 + 2 ω0² Δt t): velocities are differences."""
    points = block(5, SPACING)
    points -= points.mean(0)
    velocities = np.cross((0.0, 0.0, 10.0), points)
    scene = Scene(SPACING, gravity=(0, 0, 0))
    scene.add_clay(points, Material(), velocities=velocities)
    solver = Solver(scene, PAPER)
    for _ in range(30):
        solver.step(1 / 60)
    arms, v = solver.positions().astype(float), solver.velocities().astype(float)
    arms -= arms.mean(0)
    kept = np.cross(arms, v)[:, 2].sum() / np.cross(points, velocities)[:, 2].sum()
    assert kept == pytest.approx(1 / math.sqrt(1 + 2 * 10.0**2 * 0.5 / 480), rel=0.03)
    assert np.abs(v.sum(0)).max() < 1e-5 * np.abs(velocities).sum()


def test_snapshot_is_exact():
    """Continue in a new solver with the same bits, in the middle of a press."""
    scene, poses = pressed_scene()
    solver = Solver(scene, PAPER)
    for pose in poses[:3]:
        scene.meshes[0].set_pose(pose)
        solver.step(1 / 60)
    state = solver.snapshot()
    other = Solver(scene, PAPER)
    other.restore(state)
    results = []
    for each in (solver, other):
        for pose in poses[3:]:
            scene.meshes[0].set_pose(pose)
            each.step(1 / 60)
        results.append((each.positions(), each.velocities(), each.force_on(scene.meshes[0])))
        scene.meshes[0].set_pose(poses[2])
    assert np.abs(results[0][2]).max() > 0
    for first, second in zip(*results, strict=True):
        np.testing.assert_array_equal(first, second)


def test_tool_stays_outside_of_clay():
    """Penetrate a ball only by rounding, and report a force that pushes it back."""
    scene, poses = pressed_scene()
    solver = Solver(scene, PAPER)
    for pose in poses:
        scene.meshes[0].set_pose(pose)
        solver.step(1 / 60)
    assert solver.diagnostics().max_penetration < 1e-3 * SPACING
    assert solver.force_on(scene.meshes[0])[2] > 0
    apart = np.linalg.norm(solver.positions() - poses[-1][:3, 3], axis=1)
    # The ball's mesh lies up to 3 % inside the sphere.
    assert apart.min() > 0.97 * 0.01 + 0.5 * SPACING


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_particles_step(count: int):
    """Step scenes of no, one, two and three particles."""
    scene = Scene(SPACING)
    scene.add_clay(block(3, SPACING)[:count], Material())
    scene.add_plane((0, 0, -0.01))
    solver = Solver(scene, PAPER)
    for _ in range(10):
        solver.step(1 / 60)
    assert np.isfinite(solver.positions()).all()


def test_particles_on_one_point_stay_finite_and_slow():
    """Do not fling particles apart where clay overlaps itself."""
    scene = Scene(SPACING, gravity=(0, 0, 0))
    points = np.random.default_rng(0).normal(0, 0.02 * SPACING, (40, 3))
    scene.add_clay(points, Material())
    solver = Solver(scene, PAPER)
    for _ in range(20):
        solver.step(1 / 60)
        assert solver.diagnostics().max_speed < 1.1
    assert np.isfinite(solver.positions()).all()


def test_only_what_the_settings_keep_is_built():
    """List no pass that is turned off."""
    scene = Scene(SPACING)
    scene.add_clay(block(3, SPACING), Material())
    whole = Solver(scene, PAPER).describe()
    assert "viscosity" in whole
    assert "distance constraints" in whole
    bare = Settings(model="paper", viscosity=False, elastoplasticity=False)
    text = Solver(scene, bare).describe()
    assert "viscosity" not in text
    assert "distance constraints" not in text


def test_substeps_default_to_what_the_model_needs():
    """Default to eight substeps for the paper's clay."""
    assert Settings().substeps == 4
    assert PAPER.substeps == 8
    assert Settings(model="paper", substeps=3).substeps == 3
