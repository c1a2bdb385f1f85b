# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks for 3D printing: self-intersections, thin walls, and a flat base."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
import trimesh

from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.core.surface.exact import Surface, SurfaceError, reconstruct
from tactile_clay.clay_addon.deliver.export import export_clay
from tactile_clay.clay_addon.deliver.print_checks import base_area, check_print, flat_base, untangle


def as_surface(mesh: trimesh.Trimesh) -> Surface:
    """Convert a mesh to a surface."""
    return Surface(np.array(mesh.vertices), np.array(mesh.faces).astype(np.int64))


def shell(outer: float, inner: float) -> Surface:
    """A hollow ball of two concentric spheres, far from the origin."""
    parts = [trimesh.creation.icosphere(subdivisions=4, radius=radius) for radius in (outer, inner)]
    parts[1].invert()
    surface = as_surface(trimesh.util.concatenate(parts))
    return Surface(surface.vertices + np.array([5.0, -3.0, 2.0]), surface.faces)


def test_thickness_of_a_shell_is_measured() -> None:
    """The wall of a hollow ball is measured to 2 %, and is too thin everywhere or nowhere."""
    hollow = shell(0.03, 0.028)
    thick = check_print(hollow, wall=0.0015)
    thin = check_print(hollow, wall=0.0025)
    assert thick.crossings == 0
    assert thick.thinnest_wall == pytest.approx(0.002, rel=0.02)
    assert thick.thin_share == 0
    assert thin.thin_share == pytest.approx(1.0)


def test_edges_are_not_thin_walls() -> None:
    """The thinnest wall of a block is its shortest side, though rays near edges are short."""
    block = as_surface(trimesh.creation.box((0.05, 0.04, 0.01)).subdivide_to_size(0.002))
    report = check_print(block, wall=0.009)
    assert report.thinnest_wall == pytest.approx(0.01, rel=0.01)
    assert report.thin_share == 0
    assert check_print(block, wall=0.011).thin_share == pytest.approx(4000 / 5800, abs=0.02)


def test_crossings_are_counted() -> None:
    """Two overlapping balls intersect along a circle; separate balls do not."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    other = ball.copy()
    other.apply_translation((0.021, 0.003, 0.001))
    both = as_surface(trimesh.util.concatenate([ball, other]))
    assert check_print(both, wall=0).crossings > 40
    other.apply_translation((0.02, 0, 0))
    apart = as_surface(trimesh.util.concatenate([ball, other]))
    assert check_print(apart, wall=0).crossings == 0


@pytest.mark.parametrize("offset", [0.0, 100.0])
def test_base_is_flat_and_the_rest_is_unchanged(offset: float) -> None:
    """A ball without its cap is closed, has the right volume, base area and colors."""
    radius, depth = 0.03, 0.004
    ball = as_surface(trimesh.creation.icosphere(subdivisions=5, radius=radius))
    colors = np.zeros((len(ball.vertices), 4), np.float32)
    colors[:, 0] = ball.vertices[:, 2] / radius
    cut = flat_base(Surface(ball.vertices + offset, ball.faces, colors), depth)
    cut.check()
    cap = np.pi * depth**2 * (3 * radius - depth) / 3
    assert ball.volume - cut.volume == pytest.approx(cap, rel=0.01)
    lowest = cut.vertices[:, 2].min() - offset
    assert lowest == pytest.approx(depth - radius, abs=1e-5)
    assert base_area(cut) == pytest.approx(np.pi * depth * (2 * radius - depth), rel=0.01)
    assert cut.colors is not None
    height = (cut.vertices[:, 2] - offset) / radius
    np.testing.assert_allclose(cut.colors[:, 0], height, atol=0.05)


def test_base_beyond_the_clay_is_refused() -> None:
    """A base that removes all of the clay is refused."""
    ball = as_surface(trimesh.creation.icosphere(radius=0.03))
    for depth in (0.06, 1.0, -0.1):
        with pytest.raises(SurfaceError, match=r"0\.06 high"):
            flat_base(ball, depth)


def test_ordinary_clay_has_no_crossings() -> None:
    """A block, a ball and a slab two particles thick do not self-intersect."""
    grid = np.stack(np.meshgrid(*[np.arange(14) - 6.5] * 3, indexing="ij"), -1).reshape(-1, 3)
    for points in (
        grid[np.abs(grid).max(1) < 5],
        grid[np.linalg.norm(grid, axis=1) < 6],
        grid[np.abs(grid[:, 2]) < 1],
    ):
        points = points + np.random.default_rng(0).normal(0, 0.05, points.shape)
        report = check_print(reconstruct(points, 1.0), wall=1.0)
        assert report.crossings == 0
        assert report.thin_share < 1e-3


def test_self_intersecting_notch_is_untangled() -> None:
    """Two touching balls lose their intersections, stay closed and keep their volume."""
    grid = np.stack(np.meshgrid(*[np.arange(13) - 6.0] * 3, indexing="ij"), -1).reshape(-1, 3)
    ball = grid[np.linalg.norm(grid, axis=1) < 5]
    ball += np.random.default_rng(1).normal(0, 0.03, ball.shape)
    touching = reconstruct(np.concatenate([ball, ball + np.array([9.8, 0, 0])]), 1.0)
    assert check_print(touching, wall=0).crossings > 0
    untangled = untangle(touching)
    untangled.check()
    assert check_print(untangled, wall=0).crossings == 0
    assert untangled.volume == pytest.approx(touching.volume, rel=1e-3)
    assert np.linalg.norm(untangled.vertices - touching.vertices, axis=1).max() < 0.5
    assert untangle(untangled) is untangled


def test_export_measures_in_real_millimeters(studio: Any, tmp_path: Any) -> None:
    """A block of 40 mm is 40 mm in the file in any scene unit; thin walls cause a warning."""
    studio.scene.unit_settings.scale_length = 0.01
    make_clay(bpy.context, [studio.block(size=4.0, location=(0, 0, 2))], spacing=0.5)
    table = export_clay(bpy.context, tmp_path / "clay.stl", unit="auto")
    np.testing.assert_allclose(table["size"], 40, atol=1.5)
    size = np.ptp(trimesh.load(tmp_path / "clay.stl").vertices, axis=0)
    np.testing.assert_allclose(size, table["size"], rtol=1e-5)
    assert table["volume"] == pytest.approx(0.04**3, rel=0.003)
    assert table["print"]["warnings"] == []
    flat = export_clay(bpy.context, tmp_path / "clay.3mf", base=2.0)
    assert flat["print"]["base_area"] == pytest.approx(1600, rel=0.2)
    assert flat["volume"] == pytest.approx(0.04**2 * 0.038, rel=0.05)
    (warning,) = export_clay(bpy.context, tmp_path / "clay.stl", wall=50.0)["print"]["warnings"]
    assert "walls thinner than 50 mm" in warning
    assert export_clay(bpy.context, tmp_path / "clay.ply")["print"] is None
