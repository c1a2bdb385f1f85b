# SPDX-License-Identifier: GPL-3.0-or-later
"""A long layer of soft clay flowing down a rough incline: half of plane Poiseuille flow."""

import math
from dataclasses import dataclass

import numpy as np

from tactile_clay.solver import Material, Scene, Settings, Solver

from .couette import ROUGH
from .shapes import block

DENSITY = 1700.0


@dataclass(frozen=True)
class Poiseuille:
    """Steady velocities in the middle of the layer."""

    height: np.ndarray
    """Height of each layer of particles above the lowest one, which sticks [m]."""
    speed: np.ndarray
    """Mean speed of each layer [m/s]."""
    expected: np.ndarray
    """Speed of each layer in a Herschel-Bulkley fluid [m/s]."""

    @property
    def plug(self) -> float:
        """Speed of the upper third over that expected."""
        upper = self.height > 0.67 * self.height.max()
        return float(self.speed[upper].mean() / self.expected[upper].mean())

    @property
    def worst(self) -> float:
        """Largest difference of a layer's speed over the expected speed of the plug."""
        return float(np.abs(self.speed - self.expected).max() / self.expected.max())


def poiseuille(
    yield_ratio: float,
    *,
    layers: int = 10,
    depth: float = 0.05,
    stress: float = 2000.0,
    viscosity: float = 200.0,
    flow_index: float = 1.0,
    stiffness: float = 50.0,
    travel: float = 1.0,
    duration: float | None = None,
    jitter: float = 0.2,
    settings: Settings | None = None,
) -> Poiseuille:
    """Let a layer flow between smooth walls over a rough bed.

    Args:
        yield_ratio: Yield stress over the stress on the bed; 0 for a fluid without one.
        layers: Number of particles over its depth.
        depth: Depth of the layer [m].
        stress: Shear stress on the bed [Pa].
        viscosity: Viscosity, or consistency [Pa sⁿ].
        flow_index: Exponent of the strain rate.
        stiffness: Shear modulus over the stress on the bed.
        travel: How far its surface moves, in depths.
        duration: Duration of the flow [s], instead of ``travel``.
        jitter: Largest random offset of particles above the bed from their lattice, in spacings;
            the layers of a perfect lattice slide over one another in jolts.
        settings: Solver settings.
    """
    spacing = depth / layers
    counts = (5 * layers, 5, layers)
    # The lowest particles stick to the bed: the layer that shears ends at their centers, its
    # surface is half a spacing above the highest.
    deep = depth - 0.5 * spacing
    along = stress / (DENSITY * deep)
    scene = Scene(spacing, gravity=(along, 0.0, -2.0 * along))
    material = Material(
        density=DENSITY,
        yield_stress=yield_ratio * stress,
        viscosity=viscosity,
        flow_index=flow_index,
        shear_modulus=stiffness * stress,
        friction=ROUGH,
    )
    points = block(counts, spacing)
    noise = np.random.default_rng(0).uniform(-jitter, jitter, points.shape) * spacing
    noise[points[:, 2] < spacing] = 0.0
    scene.add_clay(points + noise, material)
    scene.add_plane(friction=ROUGH)
    half = 0.5 * counts[1] * spacing
    scene.add_plane((0, -half, 0), (0, 1, 0), friction=0.0)
    scene.add_plane((0, half, 0), (0, -1, 0), friction=0.0)
    solver = Solver(scene, settings)
    height = (np.arange(layers)) * spacing
    expected = film(height, deep, stress, yield_ratio * stress, viscosity, flow_index)
    duration = duration or travel * depth / float(expected.max())
    steps = max(20, math.ceil(duration * 60))
    middle = np.abs(points[:, 0]) < 0.5 * layers * spacing
    for step in range(steps):
        if step == steps // 2:
            begin = solver.positions().astype(float)
        solver.step(duration / steps)
    moved = (solver.positions() - begin)[:, 0] / (duration * (steps - steps // 2) / steps)
    level = np.rint(points[:, 2] / spacing - 0.5).astype(int)
    speed = np.array([moved[middle & (level == n)].mean() for n in range(layers)])
    return Poiseuille(height=height, speed=speed, expected=expected)


def film(
    height: np.ndarray, depth: float, stress: float, strength: float, viscosity: float, index: float
) -> np.ndarray:
    """Speed of a Herschel-Bulkley film at heights over its bed [m/s]."""
    power = 1.0 + 1.0 / index
    scale = stress / viscosity
    yielded = max(1.0 - strength / stress, 0.0)
    above = np.maximum(yielded - height / depth, 0.0)
    return depth * scale ** (1.0 / index) / power * (yielded**power - above**power)
