# SPDX-License-Identifier: GPL-3.0-or-later
"""Checking and cleaning up closed meshes."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver import MeshError, check_closed_mesh
from tactile_clay.solver.geometry.closed_mesh import closed_mesh, mesh_volume


def test_closed_box_passes_and_keeps_its_volume():
    """Return a box with its volume unchanged."""
    box = trimesh.creation.box((1.0, 2.0, 3.0))
    vertices, faces = check_closed_mesh(box.vertices, box.faces)
    assert mesh_volume(vertices, faces) == pytest.approx(6.0)


def test_inverted_mesh_is_turned_outside():
    """Flip a mesh that is consistently inside out."""
    box = trimesh.creation.box()
    vertices, faces = check_closed_mesh(box.vertices, box.faces[:, ::-1])
    assert mesh_volume(vertices, faces) == pytest.approx(1.0)


def test_seams_are_welded():
    """Merge vertices at the same position, which split normals duplicate."""
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
    """Refuse a mesh with one flipped face, and advise recalculating normals."""
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
    """Refuse NaN vertices, faces out of range, and an empty mesh."""
    box = trimesh.creation.box()
    vertices = np.array(box.vertices)
    vertices[3, 1] = np.nan
    with pytest.raises(MeshError, match="1 vertices that are not finite"):
        check_closed_mesh(vertices, box.faces)
    with pytest.raises(MeshError, match="does not exist"):
        check_closed_mesh(box.vertices, box.faces + 1)
    with pytest.raises(MeshError, match="no faces"):
        check_closed_mesh(np.zeros((0, 3)), np.zeros((0, 3), int))


def _solids() -> list[trimesh.Trimesh]:
    """A ball, a box, a ring and a rod side by side."""
    shapes = [
        trimesh.creation.icosphere(subdivisions=3, radius=0.03),
        trimesh.creation.box((0.06, 0.05, 0.04)),
        trimesh.creation.torus(0.025, 0.008),
        trimesh.creation.cylinder(0.01, 0.06),
    ]
    for index, shape in enumerate(shapes):
        shape.apply_translation((0.1 * index, 0.0, 0.0))
    return shapes


any_turn = st.tuples(st.floats(0, 6.3), st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 1))


@given(inverted=st.sets(st.integers(0, 3)), order=st.permutations(range(4)), turn=any_turn)
@settings(max_examples=30, deadline=None)
def test_each_body_is_turned_by_itself(
    inverted: set[int], order: list[int], turn: tuple[float, ...]
):
    """Orient every body outward whichever are inside out, and report how many were."""
    parts = _solids()
    for index in inverted:
        parts[index].invert()
    both = trimesh.util.concatenate([parts[index] for index in order])
    both.apply_transform(trimesh.transformations.rotation_matrix(turn[0], turn[1:]))
    mesh = closed_mesh(both.vertices, both.faces)
    expected = sum(part.volume for part in _solids())
    assert mesh_volume(mesh.vertices, mesh.faces) == pytest.approx(expected, rel=1e-9)
    assert mesh.shell_count == 4
    said = any("inside out" in note for note in mesh.notes)
    assert said == (0 < len(inverted) < 4)


@given(inverted=st.booleans(), radius=st.floats(0.2, 0.9))
@settings(max_examples=20, deadline=None)
def test_shell_wound_the_opposite_way_within_a_body_is_a_cavity(inverted: bool, radius: float):
    """Keep a hollow body hollow, even if the whole mesh is inside out."""
    outer = trimesh.creation.icosphere()
    inner = trimesh.creation.icosphere(radius=radius)
    inner.invert()
    hollow = trimesh.util.concatenate([outer, inner])
    faces = hollow.faces[:, ::-1] if inverted else hollow.faces
    vertices, kept = check_closed_mesh(hollow.vertices, faces)
    expected = outer.volume + inner.volume
    assert mesh_volume(vertices, kept) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("inverted", [False, True])
def test_same_shell_twice_counts_once(inverted: bool):
    """Remove the second copy, whichever way it is wound, and report it."""
    one, two = trimesh.creation.icosphere(), trimesh.creation.icosphere()
    if inverted:
        two.invert()
    both = trimesh.util.concatenate([one, two])
    mesh = closed_mesh(both.vertices, both.faces)
    assert mesh_volume(mesh.vertices, mesh.faces) == pytest.approx(one.volume)
    assert mesh.notes == ("1,280 duplicate faces removed.",)


@pytest.mark.parametrize(
    "offset", [(1, 0, 0), (1, 1, 0), (1, 1, 1)], ids=["wall", "edge", "corner"]
)
@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("welded", [False, True])
def test_bodies_that_touch_are_both_kept(
    offset: tuple[int, int, int], inverted: bool, welded: bool
):
    """Keep two boxes that share a wall, an edge or a corner, whichever way each is wound."""
    one = trimesh.creation.box()
    two = one.copy().apply_translation(offset)
    if inverted:
        two.invert()
    both = trimesh.util.concatenate([one, two])
    if welded:
        both.merge_vertices()
    if welded and inverted and offset == (1, 0, 0):
        # A single wall does not tell which way its two sides were wound.
        return
    vertices, faces = check_closed_mesh(both.vertices, both.faces)
    assert mesh_volume(vertices, faces) == pytest.approx(2.0)


@given(
    noise=st.floats(1e-9, 2e-6), scale=st.floats(1e-3, 1e3), seed=st.integers(0, 100), turn=any_turn
)
@settings(max_examples=25, deadline=None)
def test_nearly_welded_seams_are_welded(
    noise: float, scale: float, seed: int, turn: tuple[float, ...]
):
    """Close a mesh whose faces all have their own corners, a millionth of its size apart."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.apply_transform(trimesh.transformations.rotation_matrix(turn[0], turn[1:]))
    corners = ball.vertices[ball.faces].reshape(-1, 3)
    corners = scale * (corners + np.random.default_rng(seed).normal(size=corners.shape) * noise)
    mesh = closed_mesh(corners, np.arange(len(corners)).reshape(-1, 3))
    assert len(mesh.vertices) == len(ball.vertices)
    volume = mesh_volume(mesh.vertices, mesh.faces)
    assert volume == pytest.approx(ball.volume * scale**3, rel=1e-4)
    assert any("welded" in note for note in mesh.notes)


@given(distance=st.floats(0.1, 1e7))
@settings(max_examples=10, deadline=None)
def test_loose_vertices_change_nothing(distance: float):
    """Remove vertices without faces, however far away they are, and report it."""
    box = trimesh.creation.box()
    vertices = np.concatenate([[(distance, 0.0, 0.0)], box.vertices, [(0.0, distance, 0.0)]])
    mesh = closed_mesh(vertices, box.faces + 1)
    assert len(mesh.vertices) == 8
    assert mesh.notes == ("2 vertices without faces removed.",)


def test_flat_parts_are_removed_from_a_mesh_with_bodies():
    """Keep the body, and remove a flat closed part beside it."""
    flat = trimesh.creation.icosphere(subdivisions=2)
    flat.vertices *= (1.0, 1.0, 1e-12)
    flat.apply_translation((5.0, 0.0, 0.0))
    both = trimesh.util.concatenate([trimesh.creation.box(), flat])
    mesh = closed_mesh(both.vertices, both.faces)
    assert mesh_volume(mesh.vertices, mesh.faces) == pytest.approx(1.0)
    assert any("flat part" in note for note in mesh.notes)


def test_faces_are_traced_to_the_original_mesh():
    """Return each face's index in the original mesh, and whether it was flipped."""
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere().apply_translation((5, 0, 0))
    ball.invert()
    both = trimesh.util.concatenate([box, ball])
    mesh = closed_mesh(both.vertices, both.faces)
    given_faces = both.faces[mesh.sources]
    given_faces[mesh.turned] = given_faces[mesh.turned][:, ::-1]
    np.testing.assert_allclose(both.vertices[given_faces], mesh.vertices[mesh.faces])
    assert mesh.turned.sum() == len(ball.faces)
