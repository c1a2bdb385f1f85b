# SPDX-License-Identifier: GPL-3.0-or-later
"""Simple shear between rough plates: shear modulus and flow curve.

A long slab fills a box with smooth walls. Its floor and its lid are rough and move in opposite
directions; the force on the middle third of each, away from the ends, is the shear stress, and the
strain rate is that of the particles between them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from tactile_clay.solver import Material, Scene, Settings, Solver

from .shapes import at, block

ROUGH = 1e4
"""Friction at which nothing slides."""


@dataclass(frozen=True)
class Couette:
    """Stress and strain of the middle of the slab, frame by frame."""

    material: Material
    """Material of the slab."""
    strain: np.ndarray
    """Shear strain."""
    rate: np.ndarray
    """Shear strain rate [1/s]."""
    stress: np.ndarray
    """Shear stress on the upper plate [Pa]."""

    def flow(self, begin: float) -> tuple[float, float]:
        """Mean strain rate [1/s] and stress [Pa] beyond a strain."""
        late = self.strain > begin
        return float(self.rate[late].mean()), float(self.stress[late].mean())

    def modulus(self, end: float) -> float:
        """Slope of stress over strain up to a strain [Pa], least squares through the origin."""
        early = self.strain < end
        return float(
            (self.strain[early] * self.stress[early]).sum() / (self.strain[early] ** 2).sum()
        )


def couette(
    rate: float,
    strain: float,
    *,
    material: Material | None = None,
    spacing: float = 0.005,
    counts: tuple[int, int, int] = (30, 6, 8),
    squeeze: float = 0.5,
    frames: int | None = None,
    jitter: float = 0.2,
    settings: Settings | None = None,
    probe: Callable[[Solver, np.ndarray, tuple[float, float, float]], None] | None = None,
) -> Couette:
    """Shear a slab at about ``rate`` [1/s] up to about ``strain``.

    Args:
        rate: Speed of the plates over the distance of the outermost layers [1/s].
        strain: Strain at which to stop.
        material: The clay; its friction is replaced by a high one.
        spacing: Particle spacing [m].
        counts: Particles along, across and up.
        squeeze: How far the plates first press the clay together, in spacings; otherwise it may
            detach from them.
        frames: Number of steps; by default of 1/60 s each.
        jitter: Largest random offset of particles from their lattice, in spacings; the layers of a
            perfect lattice slide over one another with less resistance.
        settings: Solver settings.
        probe: Called after each step with the solver, a mask of the particles in the middle, and
            their strain, rate and stress.
    """
    material = material or Material()
    values = {name: getattr(material, name) for name in material.__dataclass_fields__}
    material = Material(**{**values, "friction": ROUGH})
    scene = Scene(spacing, gravity=(0.0, 0.0, 0.0))
    points = block(counts, spacing)
    noise = np.random.default_rng(0).uniform(-jitter, jitter, points.shape) * spacing
    edge = (np.abs(points[:, 1]) > (0.5 * counts[1] - 1) * spacing) | (points[:, 2] < spacing)
    edge |= points[:, 2] > (counts[2] - 1) * spacing
    noise[edge] = 0.0
    scene.add_clay(points + noise, material)
    length, width, height = (count * spacing for count in counts)
    for axis, size in ((0, length), (1, width)):
        for side in (-1, 1):
            point, normal = [0.0] * 3, [0.0] * 3
            point[axis], normal[axis] = 0.5 * side * size, -float(side)
            scene.add_plane(point, normal, friction=0.0)
    thick, third, travel = 4 * spacing, length / 3, 0.5 * strain * height
    plates = []
    for side in (-1, 1):
        for part in (0, -1, 1):
            extents = np.array((third if part == 0 else third + travel, 2 * width, thick))
            center = ((part * 0.5 * (third + extents[0])), 0, 0.5 * side * thick)
            box = trimesh.creation.box(extents)
            box.apply_translation(center)
            plates.append((side, scene.add_mesh(box.vertices, box.faces, friction=ROUGH)))

    def place(shift: float, squeezed: float) -> None:
        for side, plate in plates:
            level = 0.5 * height + 0.5 * side * (height - squeezed)
            plate.set_pose(at(side * shift, 0, level))

    begin = -0.25 * strain * height
    place(begin, 0.0)
    solver = Solver(scene, settings)
    solver.begin()
    settle = 10
    for step in range(settle):
        place(begin, squeeze * spacing * (step + 1) / settle)
        solver.step(1 / 60)
    for _ in range(10):
        solver.step(1 / 60)
    sheared = (counts[2] - 1 - squeeze) * spacing
    area = third * width
    duration = strain / rate
    steps = frames or max(2, round(duration * 60))
    results = []
    before = solver.positions().astype(float)
    shear = 0.0
    for step in range(steps):
        place(begin + 0.5 * strain * sheared * (step + 1) / steps, squeeze * spacing)
        solver.step(duration / steps)
        now = solver.positions().astype(float)
        near = (np.abs(now[:, 0]) < third / 2) & (
            np.abs(now[:, 2] - 0.5 * height) < 0.5 * height - 1.5 * spacing
        )
        gradient = np.polyfit(now[near, 2], (now - before)[near, 0], 1)[0]
        before = now
        shear += gradient
        # The same stress acts on the two middle plates.
        force = 0.5 * (solver.force_on(plates[0][1])[0] - solver.force_on(plates[3][1])[0])
        results.append((shear, gradient * steps / duration, force / area))
        if probe:
            probe(solver, near, results[-1])
    strains, rates, stresses = np.array(results).T
    return Couette(material=material, strain=strains, rate=rates, stress=stresses)
