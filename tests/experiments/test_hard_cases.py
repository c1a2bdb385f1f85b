# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases: the clay stays finite, ejects nothing and comes to rest."""

import functools

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver import Material, Scene, Solver
from tactile_clay.tests.experiments import hard_cases
from tactile_clay.tests.experiments.hard_cases import CASES
from tactile_clay.tests.experiments.shapes import at, ball, block
from tactile_clay.tests.experiments.survival import (
    RELEASE_SPEED,
    SPACING,
    HardCase,
    on_table,
    survive,
)

SHORTER = {"idling": lambda: hard_cases.idle(600)}
"""Cases that are shorter here than in the report."""


@functools.cache
def outcome(name: str) -> HardCase:
    """Run a case of the table once."""
    return SHORTER.get(name, dict(CASES)[name])()


@pytest.mark.parametrize("name", [name for name, _ in CASES])
def test_hard_case_is_survived(name: str):
    """Stay finite, eject nothing faster than twice the input speed, and come to rest."""
    result = outcome(name)
    assert result.finite
    assert result.ejection_ratio <= 2.0, result
    assert result.recovered, result


def test_case_names_are_unique():
    """Give every case its own name."""
    names = [name for name, _ in CASES]
    assert len(set(names)) == len(names)


def test_interventions_are_counted():
    """Count clamped velocities, full rows, held particles and jumping tools."""
    crowded = outcome("slots overflow")
    assert crowded.clamped > 0
    assert crowded.overflow > 0
    assert outcome("particle not finite").quarantined >= 3
    assert outcome("tool jumps inside").teleported == 1


def test_a_tool_without_thickness_is_refused_with_a_message():
    """Report that two coincident faces enclose no volume."""
    assert "no volume" in outcome("tool without thickness").note


def test_a_sheet_one_particle_thick_falls_flat():
    """Drop a sheet one particle thick, which ends flat on the table."""
    solver = Solver(on_table(block((8, 8, 1), SPACING, (0, 0, 0.02))))
    solver.begin()
    for _ in range(60):
        solver.step(1 / 60)
    assert np.ptp(solver.positions()[:, 2]) < 0.1 * SPACING


def test_an_impact_flattens_and_stays_above_the_table():
    """Flatten a block at 20 m/s, without any of it passing through the table."""
    solver = Solver(on_table(block(6, SPACING, (0, 0, 0.03)), velocities=(0, 0, -20.0)))
    solver.begin()
    for _ in range(60):
        solver.step(1 / 60)
    heights = solver.positions()[:, 2]
    assert heights.min() > 0.0
    assert heights.max() < 4 * SPACING


def test_a_ball_at_two_meters_a_second_does_not_tunnel():
    """Sweep a ball through a block, with no particle ever inside it."""
    scene = on_table(block(6, SPACING))
    sphere = ball(0.012)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(-0.06, 0, 0.015))
    solver = Solver(scene)
    solver.begin()
    for frame in range(12):
        x = -0.06 + 2.0 * (frame + 1) / 60 if frame < 4 else -0.06 + 2.0 * 4 / 60
        tool.set_pose(at(x, 0, 0.015))
        solver.step(1 / 60)
        apart = np.linalg.norm(solver.positions() - (x, 0, 0.015), axis=1)
        assert apart.min() > 0.012


@given(seed=st.integers(0, 10_000), count=st.integers(1, 120), stress=st.floats(0.0, 5e4))
@settings(max_examples=8, deadline=None)
def test_any_cloud_of_particles_stays_finite_and_slow(seed: int, count: int, stress: float):
    """Drop random clouds of any yield stress, overlapping or not."""
    points = np.random.default_rng(seed).uniform(
        (-0.02, -0.02, 0.003), (0.02, 0.02, 0.03), (count, 3)
    )
    result = survive(on_table(points, Material(yield_stress=stress)), 30, calm=np.inf)
    assert result.finite
    assert result.ejection_ratio < 3.0


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Scene, float]:
    """A small random scene of blocks, planes and boxes, and its input speed."""
    spacing = draw(st.sampled_from((0.002, 0.005, 0.02)))
    gravity = draw(st.sampled_from((0.0, 9.81, 98.1)))
    scene = Scene(spacing, gravity=(0, 0, -gravity))
    fastest, height = 0.0, 0.0
    for _ in range(draw(st.integers(0, 3))):
        x, y, z = (draw(st.integers(1, 4)) for _ in range(3))
        height += draw(st.floats(0.0, 2.0)) * spacing
        material = Material(
            density=draw(st.floats(100.0, 5000.0)),
            yield_stress=draw(st.floats(0.0, 5e4)),
            viscosity=draw(st.floats(0.0, 2e3)),
            shear_modulus=draw(st.floats(1e4, 5e5)),
            friction=draw(st.floats(0.0, 2.0)),
        )
        velocity = np.array([draw(st.floats(-2.0, 2.0)) for _ in range(3)])
        scene.add_clay(block((x, y, z), spacing, (0, 0, height)), material, velocities=velocity)
        height += z * spacing
        fastest = max(fastest, float(np.linalg.norm(velocity)))
    if draw(st.booleans()):
        tilt = draw(st.floats(-0.5, 0.5))
        scene.add_plane((0, 0, -0.5 * spacing), (tilt, 0, 1), friction=draw(st.floats(0.0, 2.0)))
    for _ in range(draw(st.integers(0, 2))):
        size = [draw(st.floats(0.5, 8.0)) * spacing for _ in range(3)]
        box = trimesh.creation.box(size)
        place = [draw(st.floats(-6.0, 6.0)) * spacing for _ in range(3)]
        scene.add_mesh(box.vertices, box.faces).set_pose(at(*place))
    return scene, max(fastest + gravity * 0.2, RELEASE_SPEED)


@given(drawn=scenes(), seed=st.integers(0, 1000), frames=st.integers(1, 12))
@settings(max_examples=25, deadline=None)
def test_any_small_scene_stays_finite_and_ejects_nothing(
    drawn: tuple[Scene, float], seed: int, frames: int
):
    """Stay finite and below twice the input speed with random clay, planes and moving boxes."""
    scene, speed_in = drawn
    rng = np.random.default_rng(seed)
    starts = [mesh.pose[:3, 3].copy() for mesh in scene.meshes]
    motions = [rng.uniform(-1, 1, 3) * scene.spacing for _ in scene.meshes]

    def drive(frame: int) -> None:
        for mesh, start, motion in zip(scene.meshes, starts, motions, strict=True):
            mesh.set_pose(at(*(start + motion * (frame + 1))))

    tool_speed = max((float(np.linalg.norm(m)) * 60 for m in motions), default=0.0)
    result = survive(scene, frames, speed_in=max(speed_in, tool_speed), drive=drive, calm=np.inf)
    assert result.finite
    assert result.ejection_ratio <= 2.0, result
