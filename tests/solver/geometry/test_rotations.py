# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations: known turns, and back and forth between their two forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.solver.geometry.rotations import (
    angles_between,
    fitted_rotation,
    matrices_from_quaternions,
    product,
    quaternions_from_matrices,
    shortest_turn,
    slerp,
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
    """Turn X to Y."""
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


@given(quaternions, quaternions, st.floats(0.0, 1.0))
def test_slerp_goes_the_short_way_at_even_speed(first, second, share) -> None:
    """Turn by its share of the whole angle."""
    whole = angles_between(first, second)
    part = slerp(first, second, share)
    assert angles_between(first, part) == pytest.approx(share * whole, abs=1e-5)
    assert np.linalg.norm(part) == pytest.approx(1.0)


@given(vectors, vectors)
def test_shortest_turn_turns_no_more_than_it_must(start, end) -> None:
    """Lay one vector on the other by the angle between them."""
    turn = shortest_turn(start, end)
    assert np.allclose(turn @ start, end, atol=2e-3)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert np.trace(turn) == pytest.approx(1.0 + 2.0 * start @ end, abs=1e-5)


@given(quaternions)
def test_fitted_rotation_finds_a_rotation_and_no_mirror(quaternion) -> None:
    """Find the turn between two sets of points, also where a mirror would fit as well."""
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [1, 1, 0]], float)
    turn = matrices_from_quaternions(quaternion)
    found = fitted_rotation(flat, flat @ turn.T + [3.0, 2.0, 1.0])
    assert np.allclose(found, turn, atol=1e-6)
