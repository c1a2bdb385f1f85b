# SPDX-License-Identifier: GPL-3.0-or-later
"""A flat face of clay that is baked again finer is flat in every surface."""

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from tactile_clay.clay_addon.clay.meshes import Piece, fill_pieces
from tactile_clay.clay_addon.core.surface.exact import Surface
from tactile_clay.solver import fill_mesh
from tactile_clay.solver.geometry.closed_mesh import closed_mesh
from tactile_clay.solver.geometry.relax import relax_to_surface
from tactile_clay.tests.experiments.surface_accuracy import exact_surface, nodes_surface

FLAT = 0.05
"""How far a vertex of a flat face may lie from the face, in spacings."""
SPACING = 0.0025


def unevenness(
    surface: Surface, rotation: NDArray[np.float64], sides: NDArray[np.float64]
) -> float:
    """Root mean square distance of a box's faces from planes, the worst face, in spacings."""
    vertices = surface.vertices @ rotation
    half, worst = 0.5 * sides, 0.0
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        middle = (np.abs(vertices[:, across]) < half[across] - 5.0 * SPACING).all(1)
        for sign in (-1.0, 1.0):
            face = middle & (sign * vertices[:, axis] > half[axis] - 1.5 * SPACING)
            assert face.sum() > 20
            worst = max(worst, float(np.ptp(vertices[face, axis])) / 2.0)
    return worst / SPACING


@pytest.mark.parametrize("surface", [exact_surface, nodes_surface])
@pytest.mark.parametrize("sides", [(0.06, 0.05, 0.04), (0.0612, 0.0513, 0.0388)])
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, 0.5, 0.2), (1.0, 0.1, 2.0)])
def test_flat_faces_of_relaxed_clay_are_flat(
    studio: Any,
    surface: Callable[[NDArray[np.float64], float], Surface],
    sides: tuple[float, float, float],
    turn: tuple[float, float, float],
) -> None:
    """At every angle and size, also where no lattice plane lies in the face."""
    box = trimesh.creation.box(sides)
    rotation = trimesh.transformations.euler_matrix(*turn)[:3, :3]
    vertices = np.asarray(box.vertices) @ rotation.T
    points = fill_mesh(vertices, box.faces, SPACING)
    mesh = closed_mesh(vertices, np.asarray(box.faces))
    even = relax_to_surface(points, mesh, SPACING).astype(np.float64)
    assert unevenness(surface(even, SPACING), rotation, np.array(sides)) < FLAT


@pytest.mark.parametrize("surface", [exact_surface, nodes_surface])
@pytest.mark.parametrize(
    ("sides", "limit"), [((0.06, 0.05, 0.04), FLAT), ((0.0612, 0.0513, 0.0388), 4.0 * FLAT)]
)
def test_clay_filled_anew_at_half_the_spacing_has_no_pits(
    studio: Any,
    surface: Callable[[NDArray[np.float64], float], Surface],
    sides: tuple[float, float, float],
    limit: float,
) -> None:
    """Where the live clay's faces are flat; where they have steps of their own, these stay."""
    box = trimesh.creation.box(sides)
    coarse = fill_mesh(box.vertices, box.faces, 2.0 * SPACING).astype(np.float64)
    live = exact_surface(coarse, 2.0 * SPACING)
    mesh = closed_mesh(live.vertices, live.faces)
    (points,) = fill_pieces([Piece("Clay", mesh)], SPACING, bpy.context.scene).points
    even = relax_to_surface(points, mesh, SPACING).astype(np.float64)
    assert unevenness(surface(even, SPACING), np.eye(3), np.array(sides)) < limit
