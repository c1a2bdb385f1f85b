# SPDX-License-Identifier: GPL-3.0-or-later
"""Clay and tools shared by the experiments."""

import numpy as np
import trimesh
from numpy.typing import NDArray


def block(
    counts: int | tuple[int, int, int], spacing: float, base: tuple[float, float, float] = (0, 0, 0)
) -> NDArray[np.float64]:
    """Particles on a cubic lattice above the center of their base [m], shape [N, 3]."""
    sizes = (counts,) * 3 if isinstance(counts, int) else counts
    axes = [np.arange(size) + 0.5 for size in sizes]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    points[:, :2] -= 0.5 * np.array(sizes[:2])
    return points * spacing + np.array(base)


def cylinder(
    radius: float, height: float, spacing: float, *, jitter: float = 0.05
) -> NDArray[np.float64]:
    """Particles of an upright cylinder, slightly off their lattice [m], shape [N, 3]."""
    across = 2 * int(np.ceil(radius / spacing))
    points = block((across, across, round(height / spacing)), spacing)
    points = points[np.hypot(points[:, 0], points[:, 1]) < radius]
    points += np.random.default_rng(0).uniform(-jitter, jitter, points.shape) * spacing
    points[:, 2] = np.maximum(points[:, 2], 0.5 * spacing)
    return points


def ball(radius: float) -> trimesh.Trimesh:
    """A sphere to press with, at the origin."""
    return trimesh.creation.icosphere(subdivisions=4, radius=radius)


def at(x: float, y: float, z: float) -> NDArray[np.float64]:
    """A pose that translates [m], shape [4, 4]."""
    pose = np.eye(4)
    pose[:3, 3] = (x, y, z)
    return pose


def turned(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    """Points rotated by an angle [rad] about the y axis through their center, shape [N, 3]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    middle = points.mean(0)
    turn = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    return (points - middle) @ turn.T + middle
