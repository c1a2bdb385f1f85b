# SPDX-License-Identifier: GPL-3.0-or-later
"""Filling meshes with particles."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.solver import MeshError, fill_mesh


def test_box_becomes_its_lattice():
    """Fill a box of whole spacings with exactly its lattice, flush with its faces."""
    box = trimesh.creation.box((0.04, 0.03, 0.02))
    points = fill_mesh(box.vertices, box.faces, 0.005)
    assert len(points) == 8 * 6 * 4
    np.testing.assert_allclose(np.abs(points).max(0), (0.0175, 0.0125, 0.0075), atol=1e-6)


@given(
    minor=st.floats(0.006, 0.012),
    turn=st.floats(0.0, 3.0),
    spacing=st.floats(0.0018, 0.0026),
)
@settings(max_examples=20, deadline=None)
def test_concave_mesh_is_filled_to_one_percent(minor: float, turn: float, spacing: float):
    """Fill a rotated ring to 1 % of its volume, with all points inside."""
    ring = trimesh.creation.torus(0.02, minor)
    turned = trimesh.transformations.rotation_matrix(turn, (1.0, 0.5, 0.2))
    ring.apply_transform(turned)
    points = fill_mesh(ring.vertices, ring.faces, spacing)
    assert len(points) * spacing**3 == pytest.approx(ring.volume, rel=0.01)
    upright = points @ turned[:3, :3]
    from_circle = np.hypot(np.hypot(upright[:, 0], upright[:, 1]) - 0.02, upright[:, 2])
    assert from_circle.max() < minor + 0.5 * spacing


def test_several_bodies_are_filled_each():
    """Fill two separate balls in one mesh with the same number of particles."""
    one = trimesh.creation.icosphere(radius=0.01)
    two = one.copy().apply_translation((0.05, 0, 0))
    both = trimesh.util.concatenate([one, two])
    points = fill_mesh(both.vertices, both.faces, 0.002)
    left = (points[:, 0] < 0.025).sum()
    assert len(points) * 0.002**3 == pytest.approx(both.volume, rel=0.01)
    assert abs(2 * left - len(points)) <= 0.02 * len(points)


def test_bodies_that_overlap_are_filled_once():
    """Count the overlap of two boxes in one mesh once, and stay within half a particle of them."""
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    both = trimesh.util.concatenate([box, box.copy().apply_translation((0.02, 0, 0))])
    points = fill_mesh(both.vertices, both.faces, 0.004)
    assert len(points) == pytest.approx(1500, rel=0.01)
    assert np.abs(points[:, 1:]).max() < 0.0221
    assert points[:, 0].min() > -0.0221
    assert points[:, 0].max() < 0.0421


def test_cavity_stays_empty():
    """Leave the cavity of a hollow ball empty."""
    shell = trimesh.util.concatenate(
        [trimesh.creation.icosphere(radius=0.02), trimesh.creation.icosphere(radius=0.01)]
    )
    faces = shell.faces.copy()
    half = len(faces) // 2
    faces[half:] = faces[half:, ::-1]
    points = fill_mesh(shell.vertices, faces, 0.002)
    assert np.linalg.norm(points, axis=1).min() > 0.009
    assert len(points) * 0.002**3 == pytest.approx(4 / 3 * np.pi * (8e-6 - 1e-6), rel=0.03)


def test_filling_is_the_same_every_time_and_anywhere():
    """Return the same points again, and as many for a moved mesh."""
    ball = trimesh.creation.icosphere(radius=0.02)
    points = fill_mesh(ball.vertices, ball.faces, 0.003)
    again = fill_mesh(ball.vertices, ball.faces, 0.003)
    np.testing.assert_array_equal(points, again)
    moved = fill_mesh(ball.vertices + np.array((1.0, 2.0, 3.0)), ball.faces, 0.003)
    assert len(moved) == len(points)


def test_too_small_and_too_large_are_refused_with_advice():
    """Suggest a spacing if nothing fits, and ask about units if far too much would."""
    ball = trimesh.creation.icosphere(radius=0.001)
    with pytest.raises(MeshError, match="too small"):
        fill_mesh(ball.vertices, ball.faces, 0.005)
    with pytest.raises(MeshError, match="units"):
        fill_mesh(ball.vertices * 1e6, ball.faces, 0.005)


@given(
    shift=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)),
    far=st.sampled_from([0.0, 10.0, 100.0]),
    turn=st.floats(0, 3),
)
@settings(max_examples=20, deadline=None)
def test_volume_is_right_wherever_a_mesh_lies(
    shift: tuple[float, float, float], far: float, turn: float
):
    """Reproduce the volume to half a particle at any position and angle, up to 100 m away."""
    shape = trimesh.creation.box((0.031, 0.043, 0.027))
    shape.apply_transform(trimesh.transformations.rotation_matrix(turn, (0.3, 1.0, 0.2)))
    shape.apply_translation(np.array(shift) + far)
    points = fill_mesh(shape.vertices, shape.faces, 0.003)
    assert abs(len(points) - 0.031 * 0.043 * 0.027 / 0.003**3) < 0.51


def test_bodies_far_apart_cost_no_more_than_near_ones():
    """Fill two balls a kilometer apart without filling the space between."""
    one = trimesh.creation.icosphere(radius=0.02)
    both = trimesh.util.concatenate([one, one.copy().apply_translation((1000.0, 700.0, 0))])
    points = fill_mesh(both.vertices, both.faces, 0.004)
    assert len(points) == pytest.approx(2 * one.volume / 0.004**3, abs=1)
