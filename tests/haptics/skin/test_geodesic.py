# SPDX-License-Identifier: GPL-3.0-or-later
"""Distances along surfaces whose shortest paths are known."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_clay.haptics.skin.geodesic import geodesic_distances


def only(count: int, *indices: int) -> np.ndarray:
    """A mask that selects these vertices."""
    mask = np.zeros(count, bool)
    mask[list(indices)] = True
    return mask


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_exact_on_a_plane(seed):
    """Match straight lines on a plane with any triangulation."""
    random = np.random.default_rng(seed)
    size = 9
    grid = np.stack(np.meshgrid(np.arange(size), np.arange(size), [0.0]), -1).reshape(-1, 3)
    inner = (grid[:, :2] > 0).all(1) & (grid[:, :2] < size - 1).all(1)
    grid[inner, :2] += random.uniform(-0.2, 0.2, (inner.sum(), 2))
    faces = []
    for row in range(size - 1):
        for column in range(size - 1):
            a = row * size + column
            quad = (a, a + 1, a + size + 1, a + size)
            turn = int(random.integers(2))
            faces += [[quad[turn], quad[turn + 1], quad[turn + 2]]]
            faces += [[quad[turn], quad[turn + 2], quad[(turn + 3) % 4]]]
    source = size * size // 2
    found = geodesic_distances(grid, np.array(faces), only(len(grid), source))
    assert np.allclose(found, np.linalg.norm(grid - grid[source], axis=1), atol=1e-9)


def test_on_a_sphere_a_third_of_a_percent_off():
    """Match great circles on a sphere of 2,562 vertices."""
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    vertices = np.asarray(sphere.vertices)
    found = geodesic_distances(vertices, np.asarray(sphere.faces), only(len(vertices), 0))
    arc = 0.05 * np.arccos(np.clip(vertices @ vertices[0] / 0.05**2, -1.0, 1.0))
    error = np.abs(found - arc)[arc > 0.005] / arc[arc > 0.005]
    assert error.mean() < 0.0035
    assert error.max() < 0.014


def test_error_falls_with_the_mesh():
    """Come closer to great circles on a finer sphere."""
    errors = []
    for level in (2, 3, 4):
        sphere = trimesh.creation.icosphere(subdivisions=level)
        vertices = np.asarray(sphere.vertices)
        found = geodesic_distances(vertices, np.asarray(sphere.faces), only(len(vertices), 0))
        arc = np.arccos(np.clip(vertices @ vertices[0], -1.0, 1.0))
        errors.append(np.abs(found - arc).mean())
    assert errors[0] > 1.5 * errors[1] > 2.2 * errors[2]


def test_around_a_cylinder_within_one_percent():
    """Go around a cylinder, not through it."""
    radius, around, high = 0.01, 48, 31
    angle = np.arange(around) * 2 * np.pi / around
    height = np.arange(high) * 2 * np.pi * radius / around
    vertices = np.stack(
        [
            np.tile(radius * np.cos(angle), high),
            np.tile(radius * np.sin(angle), high),
            np.repeat(height, around),
        ],
        axis=1,
    )
    a = (np.arange(high - 1)[:, None] * around + np.arange(around)).ravel()
    b = (np.arange(high - 1)[:, None] * around + (np.arange(around) + 1) % around).ravel()
    faces = np.concatenate(
        [np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)]
    )
    found = geodesic_distances(vertices, faces, only(len(vertices), 0))
    turn = np.minimum(angle, 2 * np.pi - angle) * radius
    exact = np.hypot(np.tile(turn, high), np.repeat(height, around))
    assert np.abs(found - exact)[1:].max() < 0.01 * exact.max()


def test_straight_fronts_stay_straight():
    """Match the distance from an edge of a plane with irregular triangles."""
    random = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(12), np.arange(12), [0.0]), -1).reshape(-1, 3)
    inner = (grid[:, :2] > 0).all(1) & (grid[:, :2] < 11).all(1)
    grid[inner, :2] += random.uniform(-0.2, 0.2, (inner.sum(), 2))
    a = (np.arange(11)[:, None] * 12 + np.arange(11)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 13], 1), np.stack([a, a + 13, a + 12], 1)])
    found = geodesic_distances(grid, faces, grid[:, 0] == 0.0)
    assert np.abs(found - grid[:, 0]).max() < 0.02 * 11


def test_nearest_of_several_sources():
    """Measure from the nearest source, and give infinity where none can be reached."""
    grid = np.array([(x, y, 0.0) for x in range(11) for y in range(2)] + [(50.0, 0, 0)])
    faces = [[2 * i, 2 * i + 2, 2 * i + 1] for i in range(10)]
    faces += [[2 * i + 1, 2 * i + 2, 2 * i + 3] for i in range(10)]
    found = geodesic_distances(grid, np.array(faces), only(len(grid), 0, 20))
    assert found[8] == pytest.approx(4.0)
    assert found[14] == pytest.approx(3.0)
    assert np.isinf(found[-1])
    with pytest.raises(ValueError, match="start"):
        geodesic_distances(grid, np.array(faces), only(len(grid)))
