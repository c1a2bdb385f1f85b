# SPDX-License-Identifier: GPL-3.0-or-later
"""Thin walls of closed meshes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver.geometry.closed_mesh import closed_mesh
from tactile_clay.solver.geometry.fill import ThinWallsError, fill

turns = st.tuples(st.floats(0, 3), st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 1))


def _turned(mesh: trimesh.Trimesh, turn: tuple[float, ...]) -> trimesh.Trimesh:
    return mesh.apply_transform(trimesh.transformations.rotation_matrix(turn[0], turn[1:]))


@given(thickness=st.floats(0.05, 0.85), turn=turns)
@settings(max_examples=20, deadline=None)
def test_sheet_is_refused_with_its_thickness(thickness: float, turn: tuple[float, ...]):
    """Report the thickness of a sheet, and a spacing that fills it."""
    spacing = 0.005
    sheet = _turned(trimesh.creation.box((0.1, 0.08, thickness * spacing)), turn)
    with pytest.raises(ThinWallsError, match="Use a spacing of at most") as caught:
        fill(closed_mesh(sheet.vertices, sheet.faces), spacing)
    named = float(str(caught.value).split("at most ")[1].split(" mm")[0]) * 1e-3
    assert named == pytest.approx(thickness * spacing, rel=0.1)
    filled = fill(closed_mesh(sheet.vertices, sheet.faces), named)
    assert len(filled.points) * named**3 == pytest.approx(sheet.volume, rel=0.01)


@given(thickness=st.floats(0.05, 0.8), turn=turns)
@settings(max_examples=10, deadline=None)
def test_layer_follows_the_sheet(thickness: float, turn: tuple[float, ...]):
    """Cover a whole sheet with one layer in its middle, one particle per spacing²."""
    spacing = 0.005
    matrix = trimesh.transformations.rotation_matrix(turn[0], turn[1:])
    sheet = trimesh.creation.box((0.1, 0.08, thickness * spacing)).apply_transform(matrix)
    filled = fill(closed_mesh(sheet.vertices, sheet.faces), spacing, follow_thin_walls=True)
    assert len(filled.points) == pytest.approx(320, rel=0.12)
    local = filled.points @ matrix[:3, :3]
    assert np.abs(local[:, 2]).max() < 0.1 * spacing
    grid = np.stack(np.meshgrid(np.linspace(-0.045, 0.045, 19), np.linspace(-0.035, 0.035, 15)), -1)
    gap = np.linalg.norm(grid.reshape(-1, 1, 2) - local[None, :, :2], axis=2).min(1)
    assert gap.max() < 1.1 * spacing
    assert any("One layer" in note for note in filled.notes)


def test_thin_part_of_a_thick_mesh_is_reported_and_can_be_followed():
    """Report how much of a box with a thin disc is thin; follow the disc on request."""
    disc = trimesh.creation.cylinder(0.06, 0.001, sections=64).apply_translation((0.2, 0, 0))
    both = trimesh.util.concatenate([trimesh.creation.box((0.15, 0.1, 0.1)), disc])
    mesh = closed_mesh(both.vertices, both.faces)
    plain = fill(mesh, 0.004)
    assert any("particles are missing there" in note for note in plain.notes)
    followed = fill(mesh, 0.004, follow_thin_walls=True)
    in_disc = followed.points[:, 0] > 0.1
    assert in_disc.sum() == pytest.approx(np.pi * 0.06**2 / 0.004**2, rel=0.15)


@given(size=st.floats(2.0, 12.0), turn=turns)
@settings(max_examples=15, deadline=None)
def test_thick_meshes_are_filled_without_notes(size: float, turn: tuple[float, ...]):
    """Return no notes for boxes and balls of two spacings and more."""
    spacing = 0.005
    for shape in (
        trimesh.creation.box((size * spacing,) * 3),
        trimesh.creation.icosphere(radius=size * spacing),
    ):
        _turned(shape, turn)
        filled = fill(closed_mesh(shape.vertices, shape.faces), spacing)
        assert filled.notes == ()
        assert abs(len(filled.points) - shape.volume / spacing**3) <= 0.5001
