# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of points below a skin, and the nearest points on it."""

import numpy as np
import trimesh

from tactile_clay.solver.geometry.skin_query import SkinQuery


def test_depth_and_nearest_corner_of_a_box() -> None:
    """Measure depths inside and outside a box, and find the nearest corner."""
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    found = SkinQuery(box.vertices, box.faces.astype(np.int32)).nearest(
        np.array([[0.5, 0.1, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 2.0], [0.9, 0.9, 0.95]])
    )
    np.testing.assert_allclose(found.depth, [0.5, -1.0, -np.sqrt(3.0), 0.05], atol=1e-6)
    np.testing.assert_allclose(found.place[2], [1.0, 1.0, 1.0], atol=1e-6)
    np.testing.assert_array_equal(box.vertices[found.vertex[2:]], [[1, 1, 1], [1, 1, 1]])
    assert (box.faces[found.face] == found.vertex[:, None]).any(1).all()


def test_far_from_the_origin_depths_stay_exact() -> None:
    """Keep micrometer precision for a hand a kilometer from the origin."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.01)
    offset = np.array([1000.0, -500.0, 20.0])
    query = SkinQuery(ball.vertices + offset, ball.faces.astype(np.int32))
    (depth,) = query.nearest(offset[None]).depth
    assert abs(depth - 0.01) < 2e-5
