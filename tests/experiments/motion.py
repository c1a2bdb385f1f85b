# SPDX-License-Identifier: GPL-3.0-or-later
"""Momentum of free clay."""

from dataclasses import dataclass

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import block


@dataclass(frozen=True)
class Spin:
    """A block spinning freely for a while."""

    spin_kept: float
    """Angular momentum after over before."""
    momentum: float
    """Linear momentum gained over Σ m |v|."""
    spin_change_per_step: float
    """Largest relative change of angular momentum in a step."""
    radius_ratio: float
    """Farthest particle from the center, after over before."""


def spin(
    rate: float = 10.0, duration: float = 1.0, *, counts: int = 6, settings: Settings | None = None
) -> Spin:
    """Spin a block at ``rate`` [rad/s] without gravity."""
    spacing = 0.005
    points = block(counts, spacing)
    points -= points.mean(0)
    velocities = np.cross((0.0, 0.0, rate), points)
    scene = Scene(spacing, gravity=(0, 0, 0))
    scene.add_clay(points, Material(), velocities=velocities)
    solver = Solver(scene, settings)
    spins = [float(np.cross(points, velocities)[:, 2].sum())]
    for _ in range(round(duration * 60)):
        solver.step(1 / 60)
        arms = solver.positions().astype(float)
        arms -= arms.mean(0)
        spins.append(float(np.cross(arms, solver.velocities())[:, 2].sum()))
    reach = np.linalg.norm(arms, axis=1).max() / np.linalg.norm(points, axis=1).max()
    momentum = solver.velocities().astype(float).sum(0)
    return Spin(
        spin_kept=spins[-1] / spins[0],
        momentum=float(np.linalg.norm(momentum) / np.linalg.norm(velocities, axis=1).sum()),
        spin_change_per_step=float(np.abs(np.diff(spins)).max() / abs(spins[0])),
        radius_ratio=float(reach),
    )


@dataclass(frozen=True)
class Collision:
    """Two blocks meeting in mid-air."""

    momentum_change: float
    """Change of linear momentum over Σ m |v| at the start."""
    spin_change: float
    """Change of angular momentum over Σ m |x × v| at the start."""
    momentum_change_per_step: float
    """Largest change of linear momentum in a step, over the same scale."""
    spin_change_per_step: float
    """Largest change of angular momentum in a step, over the same scale."""


def collision(speed: float = 0.5, *, settings: Settings | None = None) -> Collision:
    """Let two blocks of different density meet off-center without gravity."""
    spacing = 0.005
    heavy, light = Material(density=2000.0), Material(density=1000.0)
    left = block(5, spacing, (-0.02, 0.0, 0.0))
    right = block(5, spacing, (0.02, 0.008, 0.004))
    scene = Scene(spacing, gravity=(0, 0, 0))
    scene.add_clay(left, heavy, velocities=(speed, 0, 0))
    scene.add_clay(right, light, velocities=(-speed, 0, 0))
    solver = Solver(scene, settings)
    mass = np.repeat((heavy.density, light.density), (len(left), len(right)))[:, None]

    def momenta() -> tuple[np.ndarray, np.ndarray]:
        x, p = solver.positions().astype(float), mass * solver.velocities()
        return p.sum(0), np.cross(x, p).sum(0)

    before = momenta()
    p = mass * solver.velocities()
    scale = np.linalg.norm(p, axis=1).sum()
    spin_scale = np.linalg.norm(np.cross(solver.positions(), p), axis=1).sum()
    history = [before]
    for _ in range(30):
        solver.step(1 / 60)
        history.append(momenta())
    after = history[-1]
    jumps = np.linalg.norm(np.diff(np.array(history), axis=0), axis=2).max(0)
    return Collision(
        momentum_change=float(np.linalg.norm(after[0] - before[0]) / scale),
        spin_change=float(np.linalg.norm(after[1] - before[1]) / spin_scale),
        momentum_change_per_step=float(jumps[0] / scale),
        spin_change_per_step=float(jumps[1] / spin_scale),
    )
