# SPDX-License-Identifier: GPL-3.0-or-later
"""Stiffness of an elastic block, sheared and compressed without yielding."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from tactile_clay.solver import Material, MeshCollider, Scene, Settings, Solver

from .shapes import at, block

UNYIELDING = 1e9
"""A yield stress that is never reached [Pa]."""
STIFFNESS_OVER_SHEAR = (2.5, 3.0)
"""Young's modulus over the shear modulus, 2 (1 + ν): from ν = ¼, for bonds alone (a network of
central forces), to ν = ½, when the pressure keeps the volume."""


@dataclass(frozen=True)
class Elastic:
    """A force, and its expected value from the modulus."""

    force: float
    """Measured force [N]."""
    expected: float
    """G γ A in shear; E ε A in compression, with the mean of `STIFFNESS_OVER_SHEAR` [N]."""
    returned: float
    """Fraction of the deformation that is recovered after release."""

    @property
    def ratio(self) -> float:
        """Measured stiffness over expected."""
        return self.force / self.expected


def shear(
    strain: float = 0.03,
    *,
    counts: tuple[int, int, int] = (12, 12, 4),
    spacing: float = 0.005,
    squeeze: float = 0.01,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Elastic:
    """Shear a block between two plates that it sticks to, without gravity.

    The plates first compress it by ``squeeze``, because contacts only push. Clay near the free
    sides shears less, so a block of finite width is a little softer than G γ A.

    Args:
        strain: Motion of the upper plate over the height.
        counts: Particles along each axis.
        spacing: Particle spacing [m].
        squeeze: Compression before the shear, over the height.
        material: The clay; its yield stress is not used.
        settings: Solver settings.
    """
    material = _unyielding(material)
    solver, plates, height, area = _between_plates(
        material, counts, spacing, friction=200.0, settings=settings
    )
    lid = plates[1]
    pressed = (0.0, 0.0, -squeeze * height)
    rest = solver.positions()
    sheared = (strain * height, 0.0, -squeeze * height)
    move_evenly(solver, lid, (0, 0, 0), pressed, 10)
    move_evenly(solver, lid, pressed, pressed, 10)
    before = float(solver.force_on(lid)[0])
    move_evenly(solver, lid, pressed, sheared, 20)
    move_evenly(solver, lid, sheared, sheared, 20)
    force = before - float(solver.force_on(lid)[0])
    reached = _deformation(solver, rest)
    _let_go(solver, lid, sheared, height)
    return Elastic(
        force=force,
        expected=material.shear_modulus * strain * area,
        returned=1.0 - _deformation(solver, rest) / reached,
    )


def compress(
    strain: float = 0.03,
    *,
    counts: tuple[int, int, int] = (8, 8, 8),
    spacing: float = 0.005,
    material: Material | None = None,
    settings: Settings | None = None,
) -> Elastic:
    """Compress a block between two plates without friction and gravity.

    Args:
        strain: Compression over the height.
        counts: Particles along each axis.
        spacing: Particle spacing [m].
        material: The clay; its yield stress is not used.
        settings: Solver settings.
    """
    material = _unyielding(material)
    solver, plates, height, area = _between_plates(
        material, counts, spacing, friction=0.0, settings=settings
    )
    lid = plates[1]
    pressed = (0.0, 0.0, -strain * height)
    rest = solver.positions()
    move_evenly(solver, lid, (0, 0, 0), pressed, 20)
    move_evenly(solver, lid, pressed, pressed, 20)
    force = float(solver.force_on(lid)[2])
    reached = _deformation(solver, rest)
    _let_go(solver, lid, pressed, height)
    stiffness = material.shear_modulus * sum(STIFFNESS_OVER_SHEAR) / 2
    return Elastic(
        force=force,
        expected=stiffness * strain * area,
        returned=1.0 - _deformation(solver, rest) / reached,
    )


def _unyielding(material: Material | None) -> Material:
    return replace(
        material or Material(), yield_stress=UNYIELDING, cohesion=UNYIELDING, viscosity=0.0
    )


def _between_plates(
    material: Material,
    counts: tuple[int, int, int],
    spacing: float,
    *,
    friction: float,
    settings: Settings | None,
) -> tuple[Solver, list[MeshCollider], float, float]:
    """Make a block that just touches a plate below and above; also its height [m] and area [m²]."""
    scene = Scene(spacing, gravity=(0, 0, 0))
    scene.add_clay(block(counts, spacing), material)
    size = (2 * counts[0] * spacing, 2 * counts[1] * spacing, 0.02)
    height = counts[2] * spacing
    box = trimesh.creation.box(size)
    plates = []
    for offset in (-0.01, height + 0.01):
        moved = box.vertices + np.array((0, 0, offset))
        plates.append(scene.add_mesh(moved, box.faces, friction=friction))
    return Solver(scene, settings), plates, height, counts[0] * counts[1] * spacing**2


def _deformation(solver: Solver, rest: NDArray[np.float32]) -> float:
    """RMS distance of the particles from their positions in the rest shape [m].

    Rigid motion is removed first (Kabsch 1976, doi 10.1107/S0567739476001873).
    """
    before = rest.astype(np.float64) - rest.mean(0, dtype=np.float64)
    after = solver.positions().astype(np.float64)
    after -= after.mean(0)
    left, _, right = np.linalg.svd(before.T @ after)
    turned = before @ left @ np.diag((1.0, 1.0, np.linalg.det(left @ right))) @ right
    return float(np.sqrt(((after - turned) ** 2).sum(1).mean()))


def _let_go(
    solver: Solver, lid: MeshCollider, place: tuple[float, float, float], height: float
) -> None:
    """Remove the lid, and wait for half a second."""
    move_evenly(solver, lid, place, (place[0], place[1], place[2] + 0.2 * height), 3)
    for _ in range(30):
        solver.step(1 / 60)


def move_evenly(
    solver: Solver,
    mesh: MeshCollider,
    start: tuple[float, float, float],
    end: tuple[float, float, float],
    frames: int,
) -> None:
    """Step while a mesh moves evenly from one position to another [m]."""
    for frame in range(1, frames + 1):
        place = np.array(start) + (np.array(end) - np.array(start)) * (frame / frames)
        mesh.set_pose(at(*place))
        solver.step(1 / 60)
