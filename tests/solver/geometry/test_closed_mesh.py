# SPDX-License-Identifier: GPL-3.0-or-later
"""What counts as a closed mesh."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver import MeshError, check_closed_mesh
from tactile_clay.solver.geometry.closed_mesh import mesh_volume


def test_closed_box_passes_and_keeps_its_volume():
    """Hand back a box with its volume."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    vertices, faces = check_closed_mesh(box.vertices, box.faces)
    assert mesh_volume(vertices, faces) == pytest.approx(6.0)


def test_inverted_mesh_is_turned_outside():
    """Turn a mesh that is consistently inside out."""
    box = trimesh.creation.box()
    vertices, faces = check_closed_mesh(box.vertices, box.faces[:, ::-1])
    assert mesh_volume(vertices, faces) == pytest.approx(1.0)


def test_seams_are_welded():
    """Take vertices at the same place for one, as files with split normals have them."""
    box = trimesh.creation.box()
    split = box.vertices[box.faces].reshape(-1, 3)
    vertices, faces = check_closed_mesh(split, np.arange(len(split)).reshape(-1, 3))
    assert len(vertices) == 8
    assert len(faces) == 12


@given(removed=st.sets(st.integers(0, 1279), min_size=1, max_size=6))
@settings(max_examples=25, deadline=None)
def test_open_mesh_is_refused_with_its_hole_count(removed: set[int]):
    """Count the holes as the connected groups of open edges."""
    sphere = trimesh.creation.icosphere(subdivisions=3)
    kept = np.delete(sphere.faces, sorted(removed), axis=0)
    corners = [set(sphere.faces[face]) for face in removed]
    groups: list[set[int]] = []
    for corner in corners:
        touching = [group for group in groups if group & corner]
        groups = [group for group in groups if not group & corner]
        groups.append(corner.union(*touching))
    with pytest.raises(MeshError, match=rf"it has {len(groups)} hole"):
        check_closed_mesh(sphere.vertices, kept)


def test_mixed_winding_is_refused():
    """Refuse a mesh with one face turned, and say to recalculate normals."""
    faces = trimesh.creation.box().faces.copy()
    faces[0] = faces[0, ::-1]
    with pytest.raises(MeshError, match="normals"):
        check_closed_mesh(trimesh.creation.box().vertices, faces)


def test_flat_mesh_is_refused():
    """Refuse a closed mesh without volume."""
    box = trimesh.creation.box()
    with pytest.raises(MeshError, match="volume"):
        check_closed_mesh(box.vertices * (1.0, 1.0, 0.0) + (0, 0, 0.1), box.faces)


def test_bad_numbers_are_refused():
    """Refuse NaN vertices, faces out of range, and nothing at all."""
    box = trimesh.creation.box()
    vertices = np.array(box.vertices)
    vertices[3, 1] = np.nan
    with pytest.raises(MeshError, match="1 vertices that are not finite"):
        check_closed_mesh(vertices, box.faces)
    with pytest.raises(MeshError, match="not there"):
        check_closed_mesh(box.vertices, box.faces + 1)
    with pytest.raises(MeshError, match="no faces"):
        check_closed_mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
