# SPDX-License-Identifier: GPL-3.0-or-later
"""Particles that lie evenly up to the surface of a mesh."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tactile_clay.solver import fill_mesh
from tactile_clay.solver.geometry.closed_mesh import closed_mesh
from tactile_clay.solver.geometry.relax import WALL, relax_to_surface

TURNS = [(0.0, 0.0, 0.0), (0.3, 0.5, 0.2), (0.0, 0.785, 0.0), (1.0, 0.1, 2.0)]


def relaxed_box(
    sides: tuple[float, float, float], turn: tuple[float, float, float], spacing: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Particles in a box, in its own frame: as filled, and relaxed."""
    box = trimesh.creation.box(sides)
    rotation = trimesh.transformations.euler_matrix(*turn)[:3, :3]
    vertices = np.asarray(box.vertices) @ rotation.T
    points = fill_mesh(vertices, box.faces, spacing)
    moved = relax_to_surface(points, closed_mesh(vertices, np.asarray(box.faces)), spacing)
    return points @ rotation, moved @ rotation


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("sides", [(0.06, 0.05, 0.04), (0.0624, 0.0526, 0.0376)])
@pytest.mark.parametrize("spacing", [0.005, 0.0033])
def test_the_outermost_particles_lie_in_the_faces(
    sides: tuple[float, float, float], turn: tuple[float, float, float], spacing: float
) -> None:
    """Half a spacing inside, at every angle and size, evenly and as many as before."""
    before, after = relaxed_box(sides, turn, spacing)
    assert len(after) == len(before)
    half = 0.5 * np.array(sides)
    depth = (half - np.abs(after)).min(1) / spacing
    assert depth.min() > WALL - 0.02
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        for sign in (-1.0, 1.0):
            height = (half[axis] - sign * after[:, axis]) / spacing
            outermost = after[height < WALL + 0.5][:, across]
            low, high = -half[across] + 2.0 * spacing, half[across] - 2.0 * spacing
            places = np.stack(np.meshgrid(*np.linspace(low, high, 12).T), -1).reshape(-1, 2)
            gaps = np.linalg.norm(places[:, None] - outermost, axis=2).min(1)
            # No point of a face is far from a particle right below it; 0.71 on a lattice.
            assert gaps.max() < 1.1 * spacing


@pytest.mark.parametrize("turn", TURNS)
def test_no_two_particles_are_too_close(turn: tuple[float, float, float]) -> None:
    """And none far from its neighbors."""
    _, after = relaxed_box((0.0624, 0.0526, 0.0376), turn, 0.005)
    nearest = [np.partition(np.linalg.norm(after - place, axis=1), 1)[1] / 0.005 for place in after]
    assert min(nearest) > 0.7
    assert max(nearest) < 1.2


def test_what_fits_the_lattice_stays() -> None:
    """A block whose faces are lattice planes is in balance."""
    before, after = relaxed_box((0.06, 0.05, 0.04), (0.0, 0.0, 0.0), 0.005)
    np.testing.assert_allclose(after, before, atol=0.03 * 0.005)


def test_the_unit_does_not_matter() -> None:
    """Lengths may be in Blender units."""
    box = trimesh.creation.box((0.0624, 0.0526, 0.0376))
    mesh = closed_mesh(np.asarray(box.vertices), np.asarray(box.faces))
    larger = closed_mesh(100.0 * np.asarray(box.vertices), np.asarray(box.faces))
    points = fill_mesh(box.vertices, box.faces, 0.005)
    moved = relax_to_surface(points, mesh, 0.005)
    scaled = relax_to_surface(100.0 * points, larger, 0.5)
    np.testing.assert_allclose(scaled / 100.0, moved, atol=0.05 * 0.005)
