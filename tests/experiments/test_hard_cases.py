# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases: whatever happens, the clay stays finite, throws nothing about and comes to rest."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver import Diagnostics, Material, Scene, Solver
from tactile_clay.tests.experiments.shapes import at, block

SPACING = 0.005


def table_scene(points: np.ndarray, material: Material | None = None, **clay: object) -> Scene:
    """Clay over a table."""
    scene = Scene(SPACING)
    scene.add_clay(points, material or Material(), **clay)  # type: ignore[arg-type]
    scene.add_plane()
    return scene


def run(
    scene: Scene, frames: int, drive: Callable[[int], None] = lambda frame: None
) -> tuple[Solver, float]:
    """Step a scene.

    Returns:
        The solver, and the highest speed that any particle had [m/s].
    """
    solver = Solver(scene)
    fastest = 0.0
    for frame in range(frames):
        drive(frame)
        solver.step(1 / 60)
        fastest = max(fastest, solver.diagnostics().max_speed)
    assert np.isfinite(solver.positions()).all()
    assert np.isfinite(solver.velocities()).all()
    return solver, fastest


def state(solver: Solver) -> Diagnostics:
    """Figures after the last step."""
    return solver.diagnostics()


def test_particles_on_one_spot_part_without_an_explosion():
    """Part twenty particles that lie at the very same point, at most at a metre a second more."""
    solver, fastest = run(table_scene(np.tile((0.0, 0.0, 0.02), (20, 1))), 60)
    assert fastest < 2.0
    assert state(solver).max_speed < 0.05
    assert state(solver).clamped > 0


def test_doubled_particles_part_gently():
    """Swell where every particle was added twice, and come to rest."""
    solver, fastest = run(table_scene(np.repeat(block(4, SPACING), 2, axis=0)), 60)
    assert fastest < 2.0
    assert state(solver).max_speed < 0.02


def test_squeeze_to_a_film_ejects_nothing():
    """Squeeze a block to a twentieth of its height between plates: nothing shoots out."""
    scene = table_scene(block(7, SPACING))
    box = trimesh.creation.box((0.2, 0.2, 0.02))
    plate = scene.add_mesh(box.vertices, box.faces)
    plate.set_pose(at(0, 0, 0.047))
    speed = 0.0006 * 60

    def drive(frame: int) -> None:
        plate.set_pose(at(0, 0, max(0.0355 - 0.0006 * frame, 0.00175) + 0.01))

    _, fastest = run(scene, 75, drive)
    assert fastest < 0.6 + speed


def test_impact_at_twenty_metres_a_second():
    """Survive an impact at 20 m/s, flattened and at rest."""
    scene = table_scene(block(6, SPACING, (0, 0, 0.03)), velocities=(0, 0, -20.0))
    solver, fastest = run(scene, 40)
    assert fastest < 21.0
    assert state(solver).max_speed < 0.1
    assert solver.positions()[:, 2].min() > 0.0


@pytest.mark.parametrize(("below", "above"), [(1e5, 1e2), (1e2, 1e5)])
def test_density_ratio_of_a_thousand(below: float, above: float):
    """Stack clays of densities 1 : 1000 either way."""
    scene = Scene(SPACING)
    scene.add_clay(block(4, SPACING), Material(density=below))
    scene.add_clay(block(4, SPACING, (0, 0, 0.02)), Material(density=above))
    scene.add_plane()
    _, fastest = run(scene, 60)
    assert fastest < 1.0


def test_a_sheet_one_particle_thick_falls_flat():
    """Drop a sheet one particle thick: it lies flat on the table."""
    solver, _ = run(table_scene(block((8, 8, 1), SPACING, (0, 0, 0.02))), 60)
    assert np.ptp(solver.positions()[:, 2]) < 0.1 * SPACING
    assert state(solver).max_speed < 1e-3


def test_a_hundred_g():
    """Squash under a hundred times gravity without a jump."""
    scene = Scene(SPACING, gravity=(0, 0, -981.0))
    scene.add_clay(block(5, SPACING), Material())
    scene.add_plane()
    _, fastest = run(scene, 40)
    assert fastest < 2.0


def test_a_block_inside_a_tool_gets_out_slowly():
    """Let a block that begins inside a box out at no more than the depenetration speed."""
    scene = table_scene(block(5, SPACING, (0, 0, 0.02)))
    box = trimesh.creation.box((0.06, 0.06, 0.06))
    scene.add_mesh(box.vertices, box.faces).set_pose(at(0, 0, 0.03))
    _, fastest = run(scene, 60)
    assert fastest < 1.5


@given(seed=st.integers(0, 10_000), count=st.integers(1, 120), stress=st.floats(0.0, 5e4))
@settings(max_examples=12, deadline=None)
def test_any_cloud_of_particles_stays_finite_and_slow(seed: int, count: int, stress: float):
    """Let random clouds, overlapping or not, of any yield stress, fall in a heap."""
    points = np.random.default_rng(seed).uniform(
        (-0.02, -0.02, 0.003), (0.02, 0.02, 0.03), (count, 3)
    )
    _, fastest = run(table_scene(points, Material(yield_stress=stress)), 30)
    assert fastest < 3.0
