# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay on a potter's wheel, and a disc of clay spun until it flows."""

import math
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import block

GRAVITY = 9.81


@dataclass(frozen=True)
class Wheel:
    """A block on a turning wheel at the end."""

    turn_ratio: float
    """Angular velocity of the block about the wheel's axis over that of the wheel."""
    radius_ratio: float
    """Largest distance of a particle from the block's center, after over before."""
    slip: float
    """Motion of the block's center over the wheel's face [m]."""
    grip: float
    """μ g / ω² r at the block's center: it is carried above 1 and thrown off below."""
    weight_ratio: float
    """Force on the wheel over m g."""


def turn_wheel(
    rpm: float = 100.0,
    *,
    offset: float = 0.0,
    counts: tuple[int, int, int] = (6, 6, 4),
    turns: float = 2.0,
    friction: float = 0.5,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Wheel:
    """Accelerate a wheel evenly over one turn, and let it run.

    Args:
        rpm: Revolutions per minute.
        offset: Distance of the block's center from the axis [m].
        counts: Number of particles of the block along each axis.
        turns: Turns at full speed.
        friction: Friction coefficient of wheel and clay.
        spacing: Particle spacing [m].
        material: The clay; its friction is not used.
        settings: Solver settings.
    """
    material = material or Material(friction=friction)
    rate = rpm * 2 * math.pi / 60
    scene = Scene(spacing)
    points = block(counts, spacing, (offset, 0.0, 0.0))
    scene.add_clay(points, material)
    disc = trimesh.creation.cylinder(0.1, 0.02, sections=48)
    face = scene.add_mesh(disc.vertices + np.array((0, 0, -0.01)), disc.faces, friction=friction)
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(10):
        solver.step(1 / 60)
    rest = solver.positions().astype(np.float64)
    begin = rest.mean(0)
    # From rest to full speed in one turn: ω t / 2 = 2 π.
    run_up = math.ceil(4 * math.pi / rate * 60)
    angle, weights = 0.0, []
    for frame in range(run_up + math.ceil(turns * 2 * math.pi / rate * 60)):
        angle += rate / 60 * min((frame + 0.5) / run_up, 1.0)
        face.set_pose(turned(angle))
        solver.step(1 / 60)
        weights.append(-solver.force_on(face)[2])
    points = solver.positions().astype(np.float64)
    velocities = solver.velocities().astype(np.float64)
    spin = np.cross(points, velocities)[:, 2].sum() / (points[:, :2] ** 2).sum()
    middle = turned(angle)[:3, :3].T @ points.mean(0)
    mass = len(points) * material.density * spacing**3
    return Wheel(
        turn_ratio=float(spin / rate),
        radius_ratio=_reach(points) / _reach(rest),
        slip=float(np.linalg.norm((middle - begin)[:2])),
        grip=friction * GRAVITY / max(rate**2 * offset, 1e-12),
        weight_ratio=float(np.mean(weights[run_up:])) / (mass * GRAVITY),
    )


@dataclass(frozen=True)
class Lump:
    """A lump of throwing clay on a wheel that turns at constant speed."""

    particle_count: int
    substeps: int
    """Substeps of the last step."""
    angle_error: float
    """Largest angle by which the lump, at any height, lagged behind the wheel after the first
    eighth of the motion, in which the clay settles on it [rad]."""
    momentum_ratio: float
    """Angular momentum about the axis over that of a rigid body on the wheel."""
    radius_ratio: float
    """Root mean square distance from the axis, after over before."""
    jumps: int
    """How often the wheel jumped instead of turning."""


def turn_lump(
    rpm: float = 100.0,
    *,
    particle_count: int = 4169,
    wheel_radius: float = 0.13,
    step: float = 1 / 60,
    turns: float = 1.0,
    spacing: float = 0.005,
) -> Lump:
    """Turn a dome of clay on a wheel.

    Args:
        rpm: Revolutions per minute, at which the clay starts too.
        particle_count: Number of particles; by default that of the paper's wheel scene.
        wheel_radius: Radius of the wheel head [m].
        step: Duration of a step [s].
        turns: Number of turns.
        spacing: Particle spacing [m].
    """
    rate = rpm * 2 * math.pi / 60
    points = dome(particle_count, spacing)
    scene = Scene(spacing)
    spin = np.cross((0.0, 0.0, rate), points)
    scene.add_clay(points, Material.preset("throwing_clay"), velocities=spin)
    disc = trimesh.creation.cylinder(wheel_radius, 0.02, sections=96)
    face = scene.add_mesh(disc.vertices + np.array((0, 0, -0.01)), disc.faces, friction=2.5)
    solver = Solver(scene, Settings(sleeping=False))
    solver.begin()
    steps = math.ceil(turns * 2 * math.pi / rate / step)
    seen = []
    for number in range(steps):
        face.set_pose(turned(rate * step * (number + 1)))
        solver.step(step)
        if number == steps // 8 or number == steps - 1:
            after = solver.positions().astype(np.float64)
            seen.append(after @ turned(rate * step * (number + 1))[:3, :3])
    layers = np.floor(points[:, 2] / (3 * spacing)).astype(int)
    errors = []
    for layer in range(layers.max() + 1):
        x, y = seen[0][layers == layer, :2], seen[1][layers == layer, :2]
        x, y = x - x.mean(0), y - y.mean(0)
        errors.append(math.atan2((x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]).sum(), (x * y).sum()))
    velocities = solver.velocities().astype(np.float64)
    inertia = (after[:, :2] ** 2).sum()
    diagnostics = solver.diagnostics()
    return Lump(
        particle_count=len(points),
        substeps=diagnostics.substeps,
        angle_error=max(abs(error) for error in errors),
        momentum_ratio=float(np.cross(after, velocities)[:, 2].sum() / inertia / rate),
        radius_ratio=_mean_radius(after) / _mean_radius(points),
        jumps=diagnostics.teleported,
    )


def dome(count: int, spacing: float) -> np.ndarray:
    """A hemisphere of exactly ``count`` particles on the plane z = 0 [m], shape [count, 3]."""
    reach = math.ceil((3 * count / (2 * math.pi)) ** (1 / 3)) + 2
    axis = np.arange(-reach, reach) + 0.5
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[grid[:, 2] > 0]
    # Equally distant particles stay in the order of the grid.
    nearest = np.argsort((grid**2).sum(1), kind="stable")[:count]
    return grid[nearest] * spacing


def hang(adhesion: float, *, spacing: float = 0.005, layers: int = 4) -> float:
    """Turn a plate with a block of clay on it upside down, and wait half a second.

    Args:
        adhesion: Adhesion of the plate [Pa].
        spacing: Particle spacing [m].
        layers: Number of particles across the block's thickness.

    Returns:
        Distance of the block's center from where it would hang [m].
    """
    scene = Scene(spacing)
    points = block((6, 6, layers), spacing)
    scene.add_clay(points, Material())
    box = trimesh.creation.box((0.1, 0.1, 0.02))
    plate = scene.add_mesh(
        box.vertices - np.array((0, 0, 0.01)), box.faces, friction=2.0, adhesion=adhesion
    )
    solver = Solver(scene)
    solver.begin()
    for _ in range(10):
        solver.step(1 / 60)
    for number in range(90):
        pose = np.eye(4)
        cosine, sine = np.cos(np.pi * (number + 1) / 90), np.sin(np.pi * (number + 1) / 90)
        pose[1:3, 1:3] = (cosine, -sine), (sine, cosine)
        plate.set_pose(pose)
        solver.step(1 / 60)
    for _ in range(30):
        solver.step(1 / 60)
    hanging = points.mean(0) * (1.0, -1.0, -1.0)
    return float(np.linalg.norm(solver.positions().mean(0) - hanging))


@dataclass(frozen=True)
class SpinningDisc:
    """A thin disc of clay that spins freely about its axis."""

    radius_ratio: float
    """Radius after over before."""
    limit_rpm: float
    """Revolutions per minute at which it becomes fully plastic: ρ ω² R² = 3 σ_Y, σ_Y = √3 τ_y
    (Timoshenko and Goodier, *Theory of Elasticity*; Tresca or von Mises yield in plane stress)."""
    spin_kept: float
    """Angular momentum after over before."""


def spin_disc(
    rpm: float = 300.0,
    *,
    limit_rpm: float = 373.0,
    radius: float = 0.03,
    layers: int = 2,
    duration: float = 1.0,
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> SpinningDisc:
    """Spin a disc without gravity, with the yield stress for a given limit by theory.

    Args:
        rpm: Initial revolutions per minute.
        limit_rpm: Revolutions per minute at the plastic limit.
        radius: Radius of the disc [m].
        layers: Number of particles across its thickness.
        duration: Duration [s].
        spacing: Particle spacing [m].
        material: The clay; its yield stress is not used.
        settings: Solver settings.
    """
    material = material or Material(viscosity=20.0)
    limit = limit_rpm * 2 * math.pi / 60
    stress = material.density * (limit * radius) ** 2 / (3 * math.sqrt(3))
    across = 2 * math.ceil(radius / spacing)
    points = block((across, across, layers), spacing)
    points = points[np.hypot(points[:, 0], points[:, 1]) < radius]
    points += np.random.default_rng(2).uniform(-0.05, 0.05, points.shape) * spacing
    points -= points.mean(0)
    velocities = np.cross((0.0, 0.0, rpm * 2 * math.pi / 60), points)
    scene = Scene(spacing, gravity=(0, 0, 0))
    clay = replace(material, yield_stress=stress)
    scene.add_clay(points, clay, velocities=velocities)
    solver = Solver(scene, settings)
    solver.begin()
    for _ in range(round(duration * 60)):
        solver.step(1 / 60)
    after = solver.positions().astype(np.float64)
    after -= after.mean(0)
    spins = [
        np.cross(x, v)[:, 2].sum()
        for x, v in ((points, velocities), (after, solver.velocities().astype(np.float64)))
    ]
    return SpinningDisc(
        radius_ratio=_mean_radius(after) / _mean_radius(points),
        limit_rpm=limit_rpm,
        spin_kept=float(spins[1] / spins[0]),
    )


def turned(angle: float) -> np.ndarray:
    """A pose rotated about the vertical by an angle [rad], shape [4, 4]."""
    pose = np.eye(4)
    pose[:2, :2] = (math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))
    return pose


def _reach(points: np.ndarray) -> float:
    """Largest horizontal distance from the center [m]."""
    return float(np.linalg.norm((points - points.mean(0))[:, :2], axis=1).max())


def _mean_radius(points: np.ndarray) -> float:
    """Root mean square distance from the axis [m]."""
    return float(np.sqrt((points[:, :2] ** 2).sum(1).mean()))
