# SPDX-License-Identifier: GPL-3.0-or-later
"""Crossings of vertical lines with closed meshes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver.geometry.closed_mesh import closed_mesh
from tactile_clay.solver.geometry.columns import cross_columns, union_volume
from tactile_clay.solver.geometry.shells import winding_number

AXIS = np.linspace(-1.5, 1.5, 31)


@given(
    turn=st.floats(0.0, 3.0),
    axis=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 1)),
    shape=st.sampled_from(["ring", "box", "ball"]),
)
@settings(max_examples=25, deadline=None)
def test_lines_are_inside_where_the_mesh_winds_around_them(
    turn: float, axis: tuple[float, float, float], shape: str
):
    """Agree with the winding number at points along every line."""
    mesh = {
        "ring": lambda: trimesh.creation.torus(0.9, 0.3),
        "box": lambda: trimesh.creation.box((1.61, 1.23, 0.8)),
        "ball": lambda: trimesh.creation.icosphere(subdivisions=2),
    }[shape]()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, axis))
    line, bottom, top = cross_columns(mesh.vertices, mesh.faces, AXIS, AXIS).intervals()
    place = np.stack([AXIS[line // 31], AXIS[line % 31], 0.5 * (bottom + top)], 1)
    long = top - bottom > 1e-3
    assert (winding_number(place[long], mesh.vertices, mesh.faces) > 0.5).all()
    length = np.zeros(31 * 31)
    np.add.at(length, line, top - bottom)
    assert length.sum() * 0.1**2 == pytest.approx(mesh.volume, rel=0.12)


def test_lines_through_corners_and_edges_cross_once():
    """Cross a box whose corners, sides and diagonals all lie on lines."""
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    axis = np.linspace(-2.0, 2.0, 17)
    line, bottom, top = cross_columns(box.vertices, box.faces, axis, axis).intervals()
    assert len(line) == 64
    np.testing.assert_allclose(bottom, -1.0)
    np.testing.assert_allclose(top, 1.0)


@given(offset=st.floats(0.0, 2.5), third=st.booleans())
@settings(max_examples=25, deadline=None)
def test_overlap_counts_once(offset: float, third: bool):
    """Return the volume of the union of overlapping boxes."""
    parts = [trimesh.creation.box(), trimesh.creation.box().apply_translation((offset, 0, 0))]
    if third:
        parts.append(trimesh.creation.box((0.5, 0.5, 0.5)))
    both = trimesh.util.concatenate(parts)
    mesh = closed_mesh(both.vertices, both.faces)
    total = sum(part.volume for part in parts[: 2 if mesh.shell_count >= 2 else 1])
    if third:
        total += 0.125
    expected = 1.0 + min(offset, 1.0)
    if mesh.shell_count == len(parts):
        assert union_volume(mesh.vertices, mesh.faces, total, 0.02) == pytest.approx(
            expected, rel=0.01
        )
