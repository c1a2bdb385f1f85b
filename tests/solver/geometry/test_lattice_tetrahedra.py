# SPDX-License-Identifier: GPL-3.0-or-later
"""Lattices of equal tetrahedra that cover cells exactly once, and points in tetrahedra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tactile_clay.solver.geometry.lattice_tetrahedra import (
    Tetrahedra,
    barycentric_weights,
    carriers,
    lattice_tetrahedra,
    tetrahedron_qualities,
    tetrahedron_volumes,
)

CELLS = arrays(np.bool_, st.tuples(*[st.integers(1, 4)] * 3))


@settings(max_examples=30, deadline=None)
@given(CELLS, st.floats(1e-3, 10.0), st.integers(0, 2**32 - 1))
def test_cells_are_covered_once(cells: np.ndarray, cell: float, seed: int) -> None:
    """Cover each point of a marked cell by exactly one tetrahedron, a twelfth of a cell each."""
    low = np.array([1.0, -2.0, 0.5])
    lattice = lattice_tetrahedra(low, cells, cell)
    volumes = tetrahedron_volumes(lattice.points, lattice.corners)
    np.testing.assert_allclose(volumes, cell**3 / 12.0, rtol=1e-9)
    where = np.argwhere(cells)
    if not len(where):
        assert len(volumes) == 0
        return
    rng = np.random.default_rng(seed)
    points = low + cell * (where[rng.integers(len(where), size=20)] + rng.random((20, 3)))
    place = lattice.points[lattice.corners]
    inside = [
        (barycentric_weights(np.broadcast_to(p, (len(place), 3)), place) > 1e-9).all(1).sum()
        for p in points
    ]
    assert inside == [1] * len(points)


def test_tetrahedra_of_the_lattice_are_nearly_regular() -> None:
    """Have dihedral angles of 60 and 90 degrees only."""
    lattice = lattice_tetrahedra(np.zeros(3), np.ones((2, 2, 2), bool), 0.1)
    place = lattice.points[lattice.corners]
    angles = []
    for i, j in ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)):
        k, m = (n for n in range(4) if n not in (i, j))
        axis = place[:, j] - place[:, i]
        first = np.cross(axis, place[:, k] - place[:, i])
        second = np.cross(axis, place[:, m] - place[:, i])
        cosine = np.einsum("ij,ij->i", first, second)
        cosine /= np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        angles.append(np.degrees(np.arccos(cosine)))
    assert set(np.round(np.concatenate(angles), 6)) == {60.0, 90.0}
    assert tetrahedron_qualities(lattice.points, lattice.corners).min() > 0.95


def test_quality_distinguishes_regular_flat_and_inverted() -> None:
    """Return 1 for a regular tetrahedron, 0 for a flat one and less for an inverted one."""
    regular = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    points = np.concatenate([regular, flat])
    corners = np.array([[0, 1, 2, 3], [1, 0, 2, 3], [4, 5, 6, 7]], np.int32)
    sign = np.sign(tetrahedron_volumes(points, corners[:1]))[0]
    qualities = sign * tetrahedron_qualities(points, corners)
    np.testing.assert_allclose(qualities, [1.0, -1.0, 0.0], atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(
    arrays(np.float64, (4, 3), elements=st.floats(-1.0, 1.0)),
    arrays(np.float64, 3, elements=st.floats(-3.0, 3.0)),
)
def test_weights_give_the_point_back(corners: np.ndarray, point: np.ndarray) -> None:
    """Reproduce a point from its weights, inside the tetrahedron or outside."""
    if abs(np.linalg.det(corners[1:] - corners[0])) < 1e-3:
        return
    (weights,) = barycentric_weights(point[None], corners[None])
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights @ corners, point, atol=1e-9)


def test_points_are_carried_by_their_own_group() -> None:
    """Prefer the first group, fall back to the second, and use no other."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    points = np.concatenate([corners, corners, corners + 5.0])
    tetrahedra = Tetrahedra(points, np.arange(12, dtype=np.int32).reshape(3, 4))
    groups = np.array([1, 2, 3])
    inside = np.array([0.2, 0.2, 0.2])
    wanted = np.array([[1, 2], [2, 1], [3, 3], [4, 2], [3, 1]])
    carrier, outside = carriers(
        np.stack([inside, inside, inside, inside, inside + 5.0]), tetrahedra, groups, wanted, 0.1
    )
    np.testing.assert_array_equal(carrier, [0, 1, -1, 1, 2])
    assert outside[0] == 0.0
    # A little outside the tetrahedron, and too far outside.
    carrier, outside = carriers(
        np.array([[-0.05, 0.2, 0.2], [-0.3, 0.2, 0.2]]), tetrahedra, groups, wanted[:2], 0.1
    )
    np.testing.assert_array_equal(carrier, [0, -1])
    assert outside[0] == pytest.approx(-0.05, abs=1e-6)
