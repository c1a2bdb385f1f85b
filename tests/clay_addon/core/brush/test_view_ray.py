# SPDX-License-Identifier: GPL-3.0-or-later
"""Projection between a view and the scene."""

import numpy as np
import pytest

from tactile_clay.clay_addon.core.brush.view_ray import View
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import look


@pytest.mark.parametrize("perspective", [True, False])
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_ray_passes_through_what_its_pixel_shows(perspective: bool, scale: float) -> None:
    """Pass within a micrometer of a projected point, in front of the origin."""
    matrices = look((0.5, -0.7, 0.4), up=(0.0, 0.0, 1.0), persp=perspective)
    view = View(*matrices, perspective, width=800, height=600, scale=scale)
    random = np.random.default_rng(5)
    for point in random.uniform(-0.1, 0.1, (20, 3)) * scale:
        pixel = view.project(point)
        assert pixel is not None
        ray = view.ray(*pixel)
        along = (point - ray.origin) @ ray.direction
        assert along > 0.0
        assert np.linalg.norm(ray.at(along) - point) < 1e-6 * scale
        assert np.linalg.norm(ray.direction) == pytest.approx(1.0)


@pytest.mark.parametrize("perspective", [True, False])
def test_a_pixel_has_the_size_of_what_it_shows(perspective: bool) -> None:
    """Space the rays of neighboring pixels by the size of a pixel."""
    matrices = look((0.0, 0.0, 0.6), persp=perspective)
    view = View(*matrices, perspective, width=800, height=600, scale=1.0)
    plane = np.array((0.0, 0.0, 0.05)), np.array((0.0, 0.0, 1.0))
    first, second = (view.ray(x, 300.0).intersect_plane(*plane) for x in (400.0, 410.0))
    assert first is not None and second is not None
    assert np.linalg.norm(second - first) == pytest.approx(10.0 * view.pixel(first), rel=1e-6)


def test_the_axes_are_those_of_the_screen() -> None:
    """Look down with X to the right and Y up."""
    view = View(*look((0.0, 0.0, 0.6)), True, width=800, height=600, scale=1.0)
    assert np.allclose((view.right, view.up, view.forward), np.diag((1.0, 1.0, -1.0)))
    assert view.project((0.0, 0.0, 1.0)) is None


def test_a_parallel_ray_does_not_intersect_a_plane() -> None:
    """Return no point for a plane that is parallel or behind."""
    view = View(*look((0.0, 0.0, 0.6)), True, width=800, height=600, scale=1.0)
    ray = view.ray(400.0, 300.0)
    up = np.array((0.0, 0.0, 1.0))
    assert ray.intersect_plane(np.array((0.0, 0.0, 1.0)), up) is None
    assert ray.intersect_plane(np.zeros(3), np.array((1.0, 0.0, 0.0))) is None
