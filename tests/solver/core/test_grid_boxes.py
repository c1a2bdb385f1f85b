# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes of a grid."""

import numpy as np
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.solver.core.grid_boxes import box_of


@wp.kernel(enable_backward=False)
def find(
    points: wp.array[wp.vec3],
    low: wp.vec3,
    inverse_edge: wp.vec3,
    counts: wp.vec3i,
    boxes: wp.array[wp.vec3i],
) -> None:
    """Find every point's box."""
    i = wp.tid()
    boxes[i] = box_of(points[i], low, inverse_edge, counts)


def boxes_of(points: np.ndarray, low: np.ndarray, edge: float, counts: tuple) -> np.ndarray:
    """Boxes of points, shape [N, 3]."""
    boxes = wp.zeros(len(points), dtype=wp.vec3i, device="cpu")
    where = wp.array(points, dtype=wp.vec3, device="cpu")
    inputs = [where, wp.vec3(*low), wp.vec3(1.0 / edge), wp.vec3i(*counts), boxes]
    wp.launch(find, dim=len(points), inputs=inputs, device="cpu")
    return boxes.numpy()


def test_points_lie_in_their_boxes():
    """Return the box of a point, for each axis independently."""
    points = np.array([[0.1, 0.1, 0.1], [0.9, 1.1, 2.9], [2.5, 0.5, 1.5]])
    found = boxes_of(points, np.zeros(3), 1.0, (3, 3, 3))
    np.testing.assert_array_equal(found, np.floor(points))


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 1e3, 1e6, 1e9]))
def test_no_point_falls_out_of_the_grid(seed: int, far: float):
    """Keep every point in the grid, even with coarse rounding far from the origin."""
    generator = np.random.default_rng(seed)
    points = (generator.uniform(-1.0, 1.0, (32, 3)) + far).astype(np.float32)
    counts = (4, 2, 3)
    low = points.min(0) + generator.uniform(-0.5, 0.5, 3)
    found = boxes_of(points, low, 0.1, counts)
    assert (found >= 0).all()
    assert (found < counts).all()
