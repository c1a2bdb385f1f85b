# SPDX-License-Identifier: GPL-3.0-or-later
"""Friction of a block on a table: pushed along, sliding to a stop, and holding on an incline."""

import math
from dataclasses import dataclass

import numpy as np
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import at, block

GRAVITY = 9.81


@dataclass(frozen=True)
class Drag:
    """A block pushed along a table at constant speed."""

    table_ratio: float
    """Friction on the table over μ m g."""
    paddle_ratio: float
    """Force on the paddle over μ m g."""
    unsteadiness: float
    """Largest deviation of the friction from its mean, over the mean."""


def drag(
    *,
    friction: float = 0.5,
    speed: float = 0.05,
    counts: tuple[int, int, int] = (6, 6, 4),
    duration: float = 1.0,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Drag:
    """Push a block with a frictionless paddle.

    Args:
        friction: Friction coefficient of table and clay.
        speed: Speed of the paddle [m/s].
        counts: Particles along each axis.
        duration: Duration of the measurement, after half a second of pushing [s].
        spacing: Particle spacing [m].
        material: The clay; its friction must be ``friction``.
        settings: Solver settings.
    """
    material = material or Material(friction=friction)
    scene = Scene(spacing)
    scene.add_clay(block(counts, spacing), material)
    table = scene.add_plane(friction=friction)
    box = trimesh.creation.box((0.02, 2 * counts[1] * spacing, 2 * counts[2] * spacing))
    paddle = scene.add_mesh(box.vertices, box.faces, friction=0.0)
    behind = -0.5 * counts[0] * spacing - 0.01
    height = counts[2] * spacing * 1.1
    paddle.set_pose(at(behind - spacing, 0, height))
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(12):
        solver.step(1 / 60)
    place, tables, paddles = behind - spacing, [], []
    pushing = round((0.5 + spacing / speed) * 60)
    for frame in range(pushing + round(duration * 60)):
        place += speed / 60
        paddle.set_pose(at(place, 0, height))
        solver.step(1 / 60)
        if frame >= pushing:
            tables.append(float(solver.force_on(table)[0]))
            paddles.append(float(-solver.force_on(paddle)[0]))
    expected = friction * math.prod(counts) * material.density * spacing**3 * GRAVITY
    mean = float(np.mean(tables))
    return Drag(
        table_ratio=mean / expected,
        paddle_ratio=float(np.mean(paddles)) / expected,
        unsteadiness=float(np.abs(np.array(tables) - mean).max() / mean),
    )


@dataclass(frozen=True)
class Stop:
    """A block that slides until friction stops it."""

    distance: float
    """Sliding distance [m]."""
    expected: float
    """v² / 2 μ g [m] at the speed when measuring began."""
    speed_after: float
    """Speed of its center at the end [m/s]."""


def stop(
    speed: float = 0.5,
    *,
    friction: float = 0.5,
    counts: tuple[int, int, int] = (6, 6, 4),
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Stop:
    """Send a resting block along a table; measure once the table carries it, after 1/60 s.

    Args:
        speed: Initial speed [m/s].
        friction: Friction coefficient of table and clay.
        counts: Particles along each axis.
        spacing: Particle spacing [m].
        material: The clay; its friction must be ``friction``.
        settings: Solver settings.
    """
    material = material or Material(friction=friction)
    scene = Scene(spacing)
    points = block(counts, spacing)
    scene.add_clay(points, material, velocities=(speed, 0, 0))
    scene.add_plane(friction=friction)
    solver = Solver(scene, settings)
    solver.begin()
    solver.step(1 / 60)
    begin = solver.positions().astype(np.float64)
    # Velocities belong to the middle of a substep (leapfrog).
    half = 0.5 / 60 / solver.diagnostics().substeps
    begun = float(solver.velocities()[:, 0].mean()) - friction * GRAVITY * half
    for _ in range(math.ceil(1.5 * speed / (friction * GRAVITY) * 60) + 10):
        solver.step(1 / 60)
    moved = solver.positions().astype(np.float64) - begin
    return Stop(
        distance=float(moved[:, 0].mean()),
        expected=begun**2 / (2 * friction * GRAVITY),
        speed_after=float(np.linalg.norm(solver.velocities().mean(0))),
    )


def creep(
    angle: float,
    *,
    friction: float = 0.5,
    counts: int = 6,
    duration: float = 2.0,
    settle: float = 1.0,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> float:
    """Creep speed of a block that sticks on an incline [m/s].

    Args:
        angle: Angle of the incline [rad], with a tangent below ``friction``.
        friction: Friction coefficient of incline and clay.
        counts: Particles along each edge.
        duration: Duration of the measurement [s].
        settle: Time before it [s].
        spacing: Particle spacing [m].
        material: The clay; its friction must be ``friction``.
        settings: Solver settings.
    """
    material = material or Material(friction=friction)
    scene = Scene(spacing, (GRAVITY * math.sin(angle), 0.0, -GRAVITY * math.cos(angle)))
    scene.add_clay(block(counts, spacing), material)
    scene.add_plane(friction=friction)
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(round(settle * 60)):
        solver.step(1 / 60)
    begin = solver.positions()[:, 0].astype(np.float64)
    for _ in range(round(duration * 60)):
        solver.step(1 / 60)
    moved = solver.positions()[:, 0].astype(np.float64) - begin
    return float(np.abs(moved).max() / duration)
