# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that tend to break simulations, and their outcomes: a table for the report.

A case passes if every state stays finite, no particle exceeds twice the input speed, and the clay
comes to rest again. Whatever the solver had to clamp, quarantine or drop is counted.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tactile_clay.solver import Material, Scene, Solver

from .hard_tools import (
    fast_tool,
    flat_tool,
    inside_a_tool,
    thin_tool,
    tool_jumps_inside,
    tool_pose_not_finite,
    two_plates,
)
from .shapes import at, ball, block, cylinder
from .survival import RELEASE_SPEED, SPACING, HardCase, judge, on_table, survive


def few_particles(count: int) -> HardCase:
    """Drop 0 to 3 particles on a table."""
    points = np.array([(0, 0, 0.01), (0.005, 0, 0.01), (0, 0.005, 0.012)])[:count]
    return survive(on_table(points), note=f"{count} particles dropped 10 mm")


def falls_freely() -> HardCase:
    """Let one particle fall beside a block that does not move: ½ g t² exactly."""
    scene = Scene(SPACING)
    scene.add_clay(np.concatenate([block(3, SPACING), [(0.1, 0, 1.0)]]), Material())
    scene.add_plane()
    solver = Solver(scene)
    solver.begin()
    for _ in range(24):
        solver.step(1 / 60)
    fallen = 1.0 - float(solver.positions()[-1, 2])
    expected = 0.5 * 9.81 * 0.4**2
    return judge(
        solver,
        bool(np.isfinite(solver.positions()).all()),
        solver.diagnostics().max_speed / (9.81 * 0.4),
        abs(fallen / expected - 1) < 1e-4,
        f"fell {fallen / expected:.6f} of ½ g t²",
    )


def coincident(count: int = 20) -> HardCase:
    """Put all particles at one point."""
    return survive(
        on_table(np.tile((0.0, 0.0, 0.02), (count, 1))), 60, note=f"{count} at one point"
    )


def doubled() -> HardCase:
    """Add every particle of a block twice."""
    return survive(on_table(np.repeat(block(4, SPACING), 2, axis=0)), 60)


def crowded() -> HardCase:
    """Crowd a hundred particles into the space of eight: rows overflow, which is counted."""
    points = np.random.default_rng(0).uniform(-1, 1, (100, 3)) * SPACING + np.array((0, 0, 0.03))
    return survive(on_table(points), 60, calm=0.05, note="100 particles in 8 d³")


def impact(speed: float = 20.0) -> HardCase:
    """Throw a block at a table at 20 m/s."""
    scene = on_table(block(6, SPACING, (0, 0, 0.03)), velocities=(0, 0, -speed))
    return survive(scene, 60, speed_in=speed, note=f"{speed:g} m/s")


def long_step(step: float = 0.1) -> HardCase:
    """Take steps of a tenth of a second while a tool pushes."""
    scene = on_table(block(6, SPACING, (0, 0, 0.01)))
    sphere = ball(0.01)
    tool = scene.add_mesh(sphere.vertices, sphere.faces)
    tool.set_pose(at(0, 0, 0.07))

    def drive(frame: int) -> None:
        tool.set_pose(at(0, 0, max(0.07 - 0.01 * frame, 0.04)))

    return survive(scene, 12, speed_in=RELEASE_SPEED, drive=drive, step=step, note="Δt .1 s")


def stretched(ratio: float = 10.0) -> HardCase:
    """Tear a bar to ten times its length, with velocities proportional to position."""
    points = block((12, 4, 4), SPACING)
    half = 6 * SPACING
    speed = 0.5 * (ratio - 1) * 2 * half / 0.1
    velocities = np.zeros_like(points)
    velocities[:, 0] = points[:, 0] / half * speed
    scene = on_table(points, velocities=velocities)
    return survive(scene, 90, speed_in=speed, calm=0.05, note=f"ends at ±{speed:.1f} m/s")


def density_ratio(below: float, above: float) -> HardCase:
    """Stack clays whose densities are a thousand times apart."""
    scene = Scene(SPACING)
    scene.add_clay(block(4, SPACING), Material(density=below))
    scene.add_clay(block(4, SPACING, (0, 0, 0.02)), Material(density=above))
    scene.add_plane()
    return survive(scene, 90, calm=0.05, note=f"{below:g} kg/m³ below {above:g} kg/m³")


def sheet() -> HardCase:
    """Drop a sheet one particle thick."""
    return survive(on_table(block((8, 8, 1), SPACING, (0, 0, 0.02))), note="gradients have rank 2")


def string() -> HardCase:
    """Drop a row of single particles, upright."""
    return survive(on_table(block((1, 1, 12), SPACING, (0, 0, 0.01))), 120, note="rank 1, upright")


def without_gravity() -> HardCase:
    """Leave a block alone without gravity."""
    return survive(on_table(block(5, SPACING, (0, 0, 0.01)), gravity=0.0), 120, calm=1e-4)


def hundred_g() -> HardCase:
    """Squash a block under a hundred times gravity."""
    return survive(on_table(block(5, SPACING), gravity=981.0), 90, calm=0.05)


def particle_not_finite() -> HardCase:
    """Make velocities non-finite in a running simulation: those particles are held and counted."""
    solver = Solver(on_table(block(5, SPACING)))
    solver.begin()
    solver.step(1 / 60)
    state = solver.snapshot()
    state["velocity"][[3, 60]] = np.nan
    state["velocity"][100] = np.inf
    solver.restore(state)
    fastest, finite = 0.0, True
    for _ in range(30):
        solver.step(1 / 60)
        finite &= bool(np.isfinite(solver.positions()).all())
        finite &= bool(np.isfinite(solver.velocities()).all())
        fastest = max(fastest, solver.diagnostics().max_speed)
    counted = solver.diagnostics().quarantined >= 3
    return judge(
        solver,
        finite,
        fastest / RELEASE_SPEED,
        counted and solver.diagnostics().max_speed < 0.02,
        "3 velocities not finite",
    )


def deterministic() -> HardCase:
    """Run the same scene twice, and again from a snapshot: all yield the same bits."""

    def make() -> Solver:
        points = np.random.default_rng(5).uniform(-0.012, 0.012, (150, 3)) + np.array((0, 0, 0.02))
        return Solver(on_table(points))

    one, two = make(), make()
    for _ in range(20):
        one.step(1 / 60)
    kept = one.snapshot()
    for _ in range(20):
        one.step(1 / 60)
    for _ in range(40):
        two.step(1 / 60)
    three = make()
    three.restore(kept)
    for _ in range(20):
        three.step(1 / 60)
    same = np.array_equal(one.positions(), two.positions())
    resumed = np.array_equal(one.positions(), three.positions())
    return judge(
        one,
        bool(np.isfinite(one.positions()).all()),
        0.0,
        same and resumed,
        f"again: {'same' if same else 'different'} bits; "
        f"from a snapshot: {'same' if resumed else 'different'} bits",
    )


def far_from_origin(distance: float = 10.0) -> HardCase:
    """Rest ten meters from the origin, where float32 resolves a micrometer."""
    scene = Scene(SPACING)
    scene.add_clay(block(5, SPACING, (distance, distance, distance)), Material())
    scene.add_plane((0, 0, distance))
    return survive(scene, 90, note=f"{distance:g} m from the origin on each axis")


def scaled(scale: float) -> HardCase:
    """Let a cylinder slump at another length scale: the result agrees to a percent of its height.

    Time is unchanged and everything else scales along (gravity with s, stresses and viscosity with
    s²), so the dimensionless numbers are the same, and so are the solver's steps.
    """
    heights = []
    results = []
    for s in (1.0, scale):
        spacing = SPACING * s
        material = Material(
            density=1800.0,
            yield_stress=220.0 * s**2,
            viscosity=20.0 * s**2,
            shear_modulus=1e5 * s**2,
            friction=1.0,
        )
        scene = Scene(spacing, gravity=(0, 0, -9.81 * s))
        scene.add_clay(cylinder(5 * SPACING, 10 * SPACING, SPACING) * s, material)
        scene.add_plane(friction=1.0)
        solver = Solver(scene)
        solver.begin()
        fastest, finite = 0.0, True
        for _ in range(45):
            solver.step(1 / 60)
            finite &= bool(np.isfinite(solver.positions()).all())
            fastest = max(fastest, solver.diagnostics().max_speed)
        heights.append(float(solver.positions()[:, 2].mean() / (5 * spacing)))
        # Nothing falls farther than the height: √(2 g H).
        ratio = fastest / np.sqrt(2 * 9.81 * s * 10 * spacing)
        results.append(
            judge(solver, finite, float(ratio), abs(heights[-1] - heights[0]) < 0.01, "")
        )
    return replace(
        results[1],
        note=f"center at {heights[1]:.4f} of its initial height, {heights[0]:.4f} at scale 1",
    )


def idle(steps: int = 3000) -> HardCase:
    """Leave a small block on a table for thousands of steps: it neither accelerates nor creeps.

    Args:
        steps: Number of steps; could be a million, since sleeping clay costs nothing.
    """
    solver = Solver(on_table(block(3, SPACING)))
    solver.begin()
    for _ in range(60):
        solver.step(1 / 60)
    begin, early = solver.positions().astype(np.float64), solver.diagnostics().max_speed
    fastest, finite = early, True
    for number in range(steps):
        solver.step(1 / 60)
        if number % 50 == 0 or number == steps - 1:
            fastest = max(fastest, solver.diagnostics().max_speed)
            finite &= bool(np.isfinite(solver.positions()).all())
    drift = float(np.linalg.norm(solver.positions() - begin, axis=1).max() / SPACING)
    late = solver.diagnostics().max_speed
    return judge(
        solver,
        finite,
        fastest / RELEASE_SPEED,
        drift < 0.01 and late <= max(2.0 * early, 1e-6),
        f"{steps} steps: drift {drift:.1e} d, speed {early:.1e} then {late:.1e} m/s",
    )


def extreme_material(name: str, material: Material) -> HardCase:
    """Drop a block of an extreme material."""
    return survive(on_table(block(5, SPACING, (0, 0, 0.02)), material), 120, calm=0.05, note=name)


CASES: list[tuple[str, Callable[[], HardCase]]] = [
    ("no particles", lambda: few_particles(0)),
    ("one particle", lambda: few_particles(1)),
    ("two particles", lambda: few_particles(2)),
    ("three particles", lambda: few_particles(3)),
    ("isolated particle in free fall", falls_freely),
    ("all particles at one point", coincident),
    ("every particle twice", doubled),
    ("slots overflow", crowded),
    ("plates to 30 %, then 5 %", two_plates),
    ("impact at 20 m/s", impact),
    ("steps of .1 s", long_step),
    ("stretch of ten times", stretched),
    ("density 1 : 1000, light below", lambda: density_ratio(1e2, 1e5)),
    ("density 1000 : 1, heavy below", lambda: density_ratio(1e5, 1e2)),
    ("sheet of one particle", sheet),
    ("string of one particle", string),
    ("tool jumps inside", tool_jumps_inside),
    ("block inside a tool", inside_a_tool),
    ("tool without thickness", flat_tool),
    ("tool of a micrometer", thin_tool),
    ("tool at 2 m/s", lambda: fast_tool(2.0)),
    ("tool at 20 m/s", fast_tool),
    ("no gravity", without_gravity),
    ("a hundred g", hundred_g),
    ("lengths times 10⁻⁴", lambda: scaled(1e-4)),
    ("lengths times 100", lambda: scaled(1e2)),
    ("idling", idle),
    ("tool pose not finite", tool_pose_not_finite),
    ("particle not finite", particle_not_finite),
    ("the same again", deterministic),
    ("far from the origin", far_from_origin),
    ("no yield stress", lambda: extreme_material("τ_y 0", Material(yield_stress=0.0))),
    ("no viscosity", lambda: extreme_material("η 0", Material(viscosity=0.0))),
    ("very viscous", lambda: extreme_material("η 10⁶ Pa s", Material(viscosity=1e6))),
    (
        "stiff",
        lambda: extreme_material("G 2 MPa", Material(shear_modulus=2e6, yield_stress=1e5)),
    ),
    (
        "very stiff",
        lambda: extreme_material("G 10 MPa", Material(shear_modulus=1e7, yield_stress=1e5)),
    ),
    ("very soft", lambda: extreme_material("G 100 Pa", Material(shear_modulus=100.0))),
    ("without cohesion", lambda: extreme_material("no tension", Material(cohesion=0.0))),
]
"""Name of each case, and the function that runs it."""
