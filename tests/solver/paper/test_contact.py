# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's contact: one-sided ghost particles and sliding anchors."""

import math

import numpy as np
import pytest
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver
from tactile_clay.solver.contact.law import DEPENETRATION_SPEED
from tactile_clay.tests.experiments.shapes import at
from tactile_clay.tests.experiments.standing import GRAVITY, stand

SPACING = 0.005
RADIUS = 0.5 * SPACING
PAPER = Settings(model="paper")


def grains_on(
    mesh: trimesh.Trimesh, points: np.ndarray, gravity: tuple[float, float, float] = (0, 0, -9.81)
) -> tuple:
    """Particles too far apart to interact, and a mesh."""
    scene = Scene(SPACING, gravity)
    scene.add_clay(points, Material(friction=0.5))
    tool = scene.add_mesh(mesh.vertices, mesh.faces, friction=0.5)
    return Solver(scene, PAPER), tool


def test_grains_rest_on_the_surface_wherever_they_land():
    """Stop falling grains at one radius above a box, without leaks or dimples."""
    box = trimesh.creation.box((0.12, 0.12, 0.02), transform=at(0, 0, -0.01))
    random = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(*[np.arange(-3, 4) * 0.017] * 2), -1).reshape(-1, 2)
    places = grid + random.uniform(-0.002, 0.002, grid.shape)
    points = np.column_stack([places, np.full(len(places), 0.006)])
    solver, tool = grains_on(box, points)
    for _ in range(12):
        solver.step(1 / 60)
    after = solver.positions()
    assert after[:, 2] == pytest.approx(RADIUS, abs=1e-6)
    assert after[:, :2] == pytest.approx(points[:, :2], abs=1e-6)
    weight = len(points) * Material().density * SPACING**3 * GRAVITY
    assert solver.force_on(tool) == pytest.approx([0, 0, -weight], abs=1e-4 * weight)


def test_grain_beside_an_edge_is_not_pushed_by_the_other_face():
    """Rest straight above the rim of a box, and fall straight past its side."""
    box = trimesh.creation.box((0.04, 0.04, 0.02), transform=at(0, 0, -0.01))
    points = np.array([[0.0195, 0.0, 0.004], [0.02 + 1.2 * RADIUS, 0.01, 0.004]])
    solver, _ = grains_on(box, points)
    for _ in range(6):
        solver.step(1 / 60)
    after = solver.positions()
    assert after[0] == pytest.approx([0.0195, 0.0, RADIUS], abs=1e-5)
    assert after[1, 0] == pytest.approx(points[1, 0], abs=1e-5)
    assert after[1, 2] < -0.02


def test_grains_slide_down_a_side_from_the_rim():
    """Slide down a face from anywhere near its rim, with friction and without a kick."""
    box = trimesh.creation.box((0.04, 0.4, 0.06), transform=at(0, 0, -0.03))
    heights = np.linspace(-1.5 * RADIUS, 0.0, 12)
    points = np.column_stack(
        [np.full(12, 0.02 + RADIUS), (np.arange(12) - 5.5) * 0.0173, heights - 1e-5]
    )
    solver, _ = grains_on(box, points, gravity=(-1.0, 0.0, -9.81))
    for _ in range(5):
        solver.step(1 / 60)
    after = solver.positions()
    assert after[:, 0] == pytest.approx(0.02 + RADIUS, abs=2e-5)
    fallen = 0.5 * (9.81 - 0.5) * 5 / 60 * (5 / 60 + 1 / 480)
    assert points[:, 2] - after[:, 2] == pytest.approx(fallen, rel=0.01)


def test_grain_in_a_corner_touches_both_faces():
    """Stop at one radius from the floor and one from the wall of an L-shaped body."""
    outline = np.array([[0, 0], [0.05, 0], [0.05, 0.01], [0.01, 0.01], [0.01, 0.05], [0, 0.05]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    body = trimesh.creation.extrude_triangulation(outline, faces, 0.04)
    solver, _ = grains_on(body, np.array([[0.02, 0.02, 0.02]]), gravity=(-9.81, -9.81, 0.0))
    for _ in range(20):
        solver.step(1 / 60)
    expected = (0.01 + RADIUS, 0.01 + RADIUS, 0.02)
    assert solver.positions()[0] == pytest.approx(expected, abs=3e-5)


def test_grain_inside_is_moved_out_slowly_along_the_surface_normal():
    """Leave through the nearest face, no faster than allowed."""
    box = trimesh.creation.box((0.08, 0.06, 0.02), transform=at(0, 0, -0.01))
    start = np.array([[0.03, 0.01, -0.6 * RADIUS]])
    solver, _ = grains_on(box, start, gravity=(0, 0, 0))
    for _ in range(3):
        solver.step(1 / 60)
        assert solver.diagnostics().max_speed < 1.01 * DEPENETRATION_SPEED
    after = solver.positions()[0]
    assert after[2] >= RADIUS - 1e-6
    assert after[:2] == pytest.approx(start[0, :2], abs=1e-6)


def test_moving_and_deforming_tool_carries_a_grain():
    """Lift a grain with a pose and then with new vertices, by friction and by impenetrability."""
    box = trimesh.creation.box((0.04, 0.04, 0.02), transform=at(0, 0, -0.01))
    solver, tool = grains_on(box, np.array([[0.001, 0.002, RADIUS]]))
    solver.begin()
    for step in range(1, 25):
        tool.set_pose(at(0.001 * step, 0, 0.002 * step))
        solver.step(1 / 60)
    expected = np.array([0.025, 0.002, 0.048 + RADIUS])
    # The grain slipped when the tool started abruptly.
    assert solver.positions()[0] == pytest.approx(expected, abs=1.5e-3)
    assert solver.positions()[0, 2] == pytest.approx(expected[2], abs=1e-5)
    for step in range(1, 13):
        tool.set_vertices(box.vertices * (1, 1, 1 - 0.02 * step) + (0, 0, 0.001 * step))
        solver.step(1 / 60)
    assert solver.positions()[0, 2] == pytest.approx(0.048 + 0.012 + RADIUS, abs=1e-5)


@pytest.mark.parametrize(("push", "slides"), [(0.48, False), (0.52, True)])
def test_friction_has_a_cone(push: float, slides: bool):
    """Hold a grain while the tangential force is below μ times the normal force."""
    scene = Scene(SPACING, gravity=(push * GRAVITY, 0.0, -GRAVITY))
    scene.add_clay(np.array([[0.0, 0.0, RADIUS]]), Material(friction=0.5))
    plane = scene.add_plane(friction=0.5)
    solver = Solver(scene, PAPER)
    for _ in range(30):
        solver.step(1 / 60)
    force = solver.force_on(plane)
    assert abs(force[0]) == pytest.approx(min(push, 0.5) * abs(force[2]), rel=1e-3)
    distance = 0.5 * (push - 0.5) * GRAVITY * 0.5**2 if slides else 0.0
    assert solver.positions()[0, 0] == pytest.approx(distance, rel=0.02, abs=1e-6)


def test_block_holds_on_an_incline_and_transmits_its_weight():
    """Stay if tan θ < μ, with m g cos θ normal to and m g sin θ along the plane."""
    angle = math.radians(15)
    result = stand(angle, friction=0.6, counts=6, settings=PAPER)
    assert result.normal_force == pytest.approx(math.cos(angle), rel=2e-3)
    assert result.tangential_force == pytest.approx(math.sin(angle), rel=2e-3)
    assert abs(result.slip) < 2e-6


def test_block_slides_on_a_steep_incline():
    """Slide with g (sin θ - μ cos θ) if tan θ > μ."""
    angle = math.radians(35)
    result = stand(angle, friction=0.6, counts=4, settings=PAPER)
    expected = GRAVITY * (math.sin(angle) - 0.6 * math.cos(angle))
    assert result.acceleration == pytest.approx(expected, rel=0.03)


def test_without_friction_everything_slides():
    """Exert no force along the plane when friction is switched off."""
    angle = math.radians(10)
    without = Settings(model="paper", friction=False)
    result = stand(angle, counts=4, duration=1.0, settings=without)
    assert result.acceleration == pytest.approx(GRAVITY * math.sin(angle), rel=0.01)
    assert abs(result.tangential_force) < 1e-6
