# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations: known cases, and conversions back and forth."""

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st

from tactile_clay.solver.geometry.rotations import (
    angles_between,
    conjugate,
    fitted_rotation,
    frame_of,
    matrices_from_quaternions,
    matrices_from_rotation_vectors,
    product,
    quaternions_from_matrices,
    rotation_and_stretch,
    rotation_vectors_from_matrices,
    shortest_turn,
    slerp,
    tangent_of,
    turned_towards,
)

HALF = np.sqrt(0.5)

quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda values: np.linalg.norm(values) > 0.1)
    .map(lambda values: np.array(values) / np.linalg.norm(values))
)
vectors = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 3)
    .filter(lambda values: np.linalg.norm(values) > 0.1)
    .map(lambda values: np.array(values) / np.linalg.norm(values))
)


def test_quarter_turn_about_z() -> None:
    """Rotate X to Y."""
    matrix = matrices_from_quaternions([0.0, 0.0, HALF, HALF])
    assert np.allclose(matrix @ [1, 0, 0], [0, 1, 0])


@given(quaternions, quaternions)
def test_forms_agree(first, second) -> None:
    """Give the same rotation as a matrix, as a quaternion, and as a product of either."""
    matrices = matrices_from_quaternions([first, second])
    back = quaternions_from_matrices(matrices)
    assert np.allclose(np.abs(np.sum(back * [first, second], axis=1)), 1.0)
    both = matrices_from_quaternions(product(first, second))
    assert np.allclose(both, matrices[0] @ matrices[1], atol=1e-9)
    undone = matrices_from_quaternions(product(first, conjugate(first)))
    assert np.allclose(undone, np.eye(3), atol=1e-9)


@given(quaternions)
def test_quaternion_of_any_rotation(quaternion) -> None:
    """Find the quaternion of a matrix made by trimesh, up to its sign, with w >= 0."""
    matrix = trimesh.transformations.quaternion_matrix(np.roll(quaternion, 1))[:3, :3]
    found = quaternions_from_matrices(matrix)
    assert abs(float(found @ quaternion)) == pytest.approx(1.0, abs=1e-6)
    assert found[3] >= 0.0


def test_any_number_of_leading_dimensions() -> None:
    """Convert an array of rotations from one form to another, like each one alone."""
    many = np.random.default_rng(1).normal(size=(2, 3, 4))
    many /= np.linalg.norm(many, axis=-1, keepdims=True)
    matrices = matrices_from_quaternions(many)
    assert matrices.shape == (2, 3, 3, 3)
    vectors = rotation_vectors_from_matrices(matrices)
    assert vectors.shape == (2, 3, 3)
    assert np.allclose(matrices_from_rotation_vectors(vectors), matrices)
    for place in np.ndindex(2, 3):
        assert np.allclose(matrices[place], matrices_from_quaternions(many[place]))
        assert np.allclose(vectors[place], rotation_vectors_from_matrices(matrices[place]))
        back = quaternions_from_matrices(matrices)[place]
        assert np.allclose(back, quaternions_from_matrices(matrices[place]))


@given(vectors, st.floats(0.0, 3.1))
def test_rotation_vector_is_axis_times_angle(axis, angle) -> None:
    """Rotate about the axis by the angle, and recover both."""
    matrix = matrices_from_rotation_vectors(axis * angle)
    expected = trimesh.transformations.rotation_matrix(angle, axis)[:3, :3]
    assert np.allclose(matrix, expected)
    assert np.allclose(rotation_vectors_from_matrices(matrix), axis * angle, atol=1e-7)


def test_no_turn_and_half_a_turn_have_rotation_vectors() -> None:
    """Return zero for the identity, and pi about the axis for half a turn."""
    assert np.array_equal(rotation_vectors_from_matrices(np.eye(3)), np.zeros(3))
    half = rotation_vectors_from_matrices(np.diag((-1.0, 1.0, -1.0)))
    assert np.allclose(np.abs(half), (0.0, np.pi, 0.0))


@given(quaternions, quaternions, st.floats(0.0, 3.2))
def test_turning_towards_a_rotation_stops_at_an_angle(first, second, max_angle) -> None:
    """Turn by at most the given angle along the shorter arc, and arrive if that suffices."""
    start, target = matrices_from_quaternions([first, second])
    whole = float(angles_between(first, second))
    assume(whole < 3.1)
    turned = turned_towards(start, target, max_angle)
    part = float(angles_between(first, quaternions_from_matrices(turned)))
    assert part == pytest.approx(min(whole, max_angle), abs=1e-6)
    rest = float(angles_between(second, quaternions_from_matrices(turned)))
    assert part + rest == pytest.approx(whole, abs=1e-6)


def test_half_a_turn_goes_about_the_handle() -> None:
    """Turn a tool about its own Z if its target is opposite."""
    turned = turned_towards(np.eye(3), np.diag((-1.0, -1.0, 1.0)), 0.5)
    assert np.allclose(turned, matrices_from_rotation_vectors((0.0, 0.0, 0.5)))


def test_polar_decomposition_puts_mirrors_into_the_stretch() -> None:
    """Split a map into a rotation and a symmetric stretch, mirrored or not."""
    turn = matrices_from_rotation_vectors((0.3, -0.8, 1.1))
    stretch = np.array([[2.0, 0.1, 0.0], [0.1, 1.0, 0.3], [0.0, 0.3, 0.5]])
    for sign in (1.0, -1.0):
        rotation, found = rotation_and_stretch(sign * turn @ stretch)
        assert np.allclose(rotation, turn)
        assert np.allclose(found, sign * stretch)


@given(vectors, vectors)
def test_frames_stand_on_the_normal(normal, tangent) -> None:
    """Return a rotation with the normal as Z, and Y leaning towards the tangent."""
    assume(abs(normal @ tangent) < 0.999)
    frame = frame_of(normal, tangent)
    assert np.allclose(frame.T @ frame, np.eye(3), atol=1e-9)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert np.allclose(frame[:, 2], normal)
    assert frame[:, 1] @ tangent >= -1e-9
    assert np.allclose(tangent_of(tangent, normal, tangent), frame[:, 1])


def test_a_direction_along_the_normal_is_replaced_by_the_fallback() -> None:
    """Use the fallback if a direction has no component perpendicular to the normal."""
    up, along = np.array((0.0, 0.0, 1.0)), np.array((0.0, 2.0, 3.0))
    assert np.allclose(tangent_of(up, up, along), (0.0, 1.0, 0.0))


@given(quaternions, quaternions, st.floats(0.0, 1.0))
def test_slerp_goes_the_short_way_at_even_speed(first, second, fraction) -> None:
    """Turn by a fraction of the whole angle."""
    whole = angles_between(first, second)
    part = slerp(first, second, fraction)
    assert angles_between(first, part) == pytest.approx(fraction * whole, abs=1e-5)
    assert np.linalg.norm(part) == pytest.approx(1.0)


@given(vectors, vectors)
def test_shortest_turn_turns_no_more_than_it_must(start, end) -> None:
    """Rotate one vector onto the other by the angle between them."""
    turn = shortest_turn(start, end)
    assert np.allclose(turn @ start, end, atol=2e-3)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert np.trace(turn) == pytest.approx(1.0 + 2.0 * start @ end, abs=1e-5)


@given(quaternions)
def test_fitted_rotation_finds_a_rotation_and_no_mirror(quaternion) -> None:
    """Find the rotation between two sets of points, even if a reflection would fit as well."""
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 1, 0]], float)
    turn = matrices_from_quaternions(quaternion)
    found = fitted_rotation(flat, flat @ turn.T + [3.0, 2.0, 1.0])
    assert np.allclose(found, turn, atol=1e-6)
