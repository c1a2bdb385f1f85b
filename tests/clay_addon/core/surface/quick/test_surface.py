# SPDX-License-Identifier: GPL-3.0-or-later
"""The quick surface is closed, smooth, in place and in the clay's colors for any particles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tactile_clay.clay_addon.core.surface.exact import SurfaceError, check_closed_manifold
from tactile_clay.clay_addon.core.surface.quick import surface as quick_surface
from tactile_clay.clay_addon.core.surface.quick.surface import QuadSurface, QuickSurface

RED, BLUE = (0.7, 0.02, 0.02, 1.0), (0.02, 0.05, 0.7, 0.5)


def lattice(*counts: int) -> np.ndarray:
    """Particles of a block, one unit apart, centered."""
    axes = [np.arange(count) - (count - 1) / 2 for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def ball(radius: float) -> np.ndarray:
    """Particles of a ball, one unit apart."""
    points = lattice(*[2 * int(radius) + 3] * 3)
    return points[np.linalg.norm(points, axis=1) < radius]


def disordered(points: np.ndarray) -> np.ndarray:
    """The particles slightly displaced, as in worked clay."""
    return points + np.random.default_rng(0).normal(0, 0.08, points.shape)


def two_colors(points: np.ndarray) -> np.ndarray:
    """Red on the left, blue on the right."""
    return np.where(points[:, :1] < 0, RED, BLUE)


def surface_of(points: np.ndarray, spacing: float = 1.0) -> QuadSurface:
    """The surface, after checking it."""
    surface = QuickSurface(spacing).reconstruct(points, two_colors(points))
    check(surface)
    return surface


def check(surface: QuadSurface) -> None:
    """Check what must hold for every surface."""
    count = len(surface.vertices)
    check_closed_manifold(surface.triangles, count)
    assert surface.vertices.shape == (count, 3)
    assert surface.colors.shape == (count, 4)
    assert np.isfinite(surface.vertices).all()
    assert np.isfinite(surface.colors).all()
    # Each face has its own edges, and each edge has two faces.
    start, end = surface.faces, np.roll(surface.faces, -1, axis=1)
    sides = np.sort(np.stack([start, end], axis=-1), axis=-1)
    np.testing.assert_array_equal(np.sort(surface.edges[surface.face_edges], axis=-1), sides)
    assert (np.bincount(surface.face_edges.ravel(), minlength=len(surface.edges)) == 2).all()


def volume(surface: QuadSurface) -> float:
    """Enclosed volume."""
    return float(trimesh.Trimesh(surface.vertices, surface.triangles, process=False).volume)


@pytest.mark.parametrize(
    ("name", "points", "tolerance"),
    [
        ("ball", ball(7), 0.03),
        ("block", lattice(12, 10, 8), 0.04),
        ("worked block", disordered(lattice(12, 12, 12)), 0.04),
        ("sheet", lattice(20, 20, 1), 0.4),
        ("double sheet", lattice(20, 20, 2), 0.1),
        ("rod", lattice(30, 1, 1), 0.35),
        ("grain", np.full((1, 3), 0.3), 0.5),
        ("pieces", np.concatenate([lattice(8, 8, 8), ball(5) + np.array([20, 0, 0])]), 0.06),
        ("hollow", lattice(14, 14, 14)[np.abs(lattice(14, 14, 14)).max(axis=1) > 3.6], 0.04),
    ],
)
def test_surface_is_closed_and_of_the_particles_volume(
    name: str, points: np.ndarray, tolerance: float
) -> None:
    """Make a closed surface with nearly the right volume for every kind of clay."""
    assert volume(surface_of(points)) == pytest.approx(len(points), rel=tolerance)


def test_surface_is_where_the_clay_ends() -> None:
    """Keep a ball round to a tenth, and a worked block's faces flat to a twentieth of a spacing."""
    points = ball(9.0)
    distance = np.linalg.norm(surface_of(points).vertices, axis=1)
    assert distance.mean() == pytest.approx(np.cbrt(len(points) * 3 / 4 / np.pi), abs=0.05)
    assert distance.std() < 0.1
    vertices = surface_of(disordered(lattice(20, 20, 8))).vertices
    top = vertices[(np.abs(vertices[:, :2]) < 7).all(axis=1) & (vertices[:, 2] > 0), 2]
    assert top.mean() == pytest.approx(4.0, abs=0.02)
    assert top.std() < 0.05


def test_colors_are_those_of_the_particles_and_mix_where_they_meet() -> None:
    """Keep colors pure away from the border, and change monotonically across it."""
    points = disordered(lattice(16, 8, 8))
    surface = surface_of(points)
    x = surface.vertices[:, 0]
    for side, color in ((x < -2, RED), (x > 2, BLUE)):
        assert side.any()
        np.testing.assert_allclose(surface.colors[side] - np.array(color), 0.0, atol=1e-5)
    means = [surface.colors[(x > low) & (x < low + 0.5), 0].mean() for low in np.arange(-2, 2, 0.5)]
    assert (np.diff(means) < 1e-6).all()
    assert ((surface.colors[:, 0] > 0.2) & (surface.colors[:, 0] < 0.5)).any()


def test_no_particles_give_an_empty_surface() -> None:
    """Make an empty surface if there are no particles, before and after there were some."""
    quick = QuickSurface(1.0)
    for points in (np.empty((0, 3)), lattice(3, 3, 3), np.empty((0, 3))):
        surface = quick.reconstruct(points, np.ones((len(points), 4)))
        assert (len(surface.faces) > 0) == (len(points) > 0)
        assert len(surface.colors) == len(surface.vertices)


def test_particles_that_are_not_finite_are_ignored() -> None:
    """Make the surface of the other particles, even if one is extremely far or has no color."""
    points = lattice(6, 6, 6)
    colors = np.tile(np.array(RED, np.float32), (len(points) + 4, 1))
    colors[3, 1] = np.nan
    broken = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [1e20, 0, 0]]
    surface = QuickSurface(1.0).reconstruct(np.concatenate([points, broken]), colors)
    check(surface)
    np.testing.assert_array_equal(surface.vertices, surface_of(points).vertices)
    np.testing.assert_allclose(surface.colors, np.tile(RED, (len(surface.colors), 1)), atol=1e-6)


@pytest.mark.parametrize("density", [0.02, 0.3, 0.8, 1.2, 4.0, 40.0])
@pytest.mark.parametrize("grain", [0.0, 0.5])
def test_random_clouds_never_give_a_broken_mesh(density: float, grain: float) -> None:
    """Make a closed mesh for clouds of any density, on a lattice or not, flat or not."""
    for count in (2, 30, 1500):
        points = np.random.default_rng(count).uniform(0, np.cbrt(count / density), (count, 3))
        if grain:
            points = np.round(points / grain) * grain
        surface_of(points)
        surface_of(points * [1, 1, 0.1])


@pytest.mark.parametrize("offset", [0.0, -3000.0])
@pytest.mark.parametrize("spacing", [1e-4, 0.005, 100.0])
def test_scale_and_place_do_not_matter(spacing: float, offset: float) -> None:
    """Make the same mesh in units of the spacing, even far from the origin."""
    # Whole numbers of blocks, so that the grid has the same alignment.
    points = ball(4) + 0.25
    reference = surface_of(points)
    elsewhere = surface_of((points + offset) * spacing, spacing)
    assert volume(elsewhere) / spacing**3 == pytest.approx(volume(reference), rel=0.01)
    middle = elsewhere.vertices.mean(axis=0, dtype=np.float64) / spacing - offset
    np.testing.assert_allclose(middle, reference.vertices.mean(axis=0), atol=0.01)


def test_result_does_not_depend_on_history() -> None:
    """Make bit-identical surfaces whatever was made before, and share no arrays."""
    quick = QuickSurface(1.0)
    before = None
    for points in (lattice(20, 20, 20), ball(5) + 60, disordered(lattice(9, 9, 9)), ball(6)):
        colors = two_colors(points)
        made = quick.reconstruct(points, colors)
        fresh = QuickSurface(1.0).reconstruct(points, colors)
        for name in ("vertices", "faces", "colors", "edges", "face_edges"):
            np.testing.assert_array_equal(getattr(made, name), getattr(fresh, name))
            if before is not None:
                assert not np.shares_memory(getattr(made, name), getattr(before, name))
        before = made


def test_still_clay_keeps_its_surface() -> None:
    """Return the same object while nothing moves, and a new one on any change or slow creep."""
    quick = QuickSurface(1.0)
    points = lattice(6, 6, 6)
    colors = two_colors(points)
    first = quick.reconstruct(points, colors)
    assert quick.reconstruct(points + 0.004, colors) is first
    assert quick.reconstruct(points + 0.008, colors) is not first
    second = quick.reconstruct(points, colors)
    colors[7] = BLUE
    assert quick.reconstruct(points, colors) is not second
    points[5, 1] = np.nan
    third = quick.reconstruct(points, colors)
    assert quick.reconstruct(points, colors) is not second
    check(third)


def test_bad_input_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Say what is wrong with shapes, spacing and widely scattered particles."""
    with pytest.raises(SurfaceError, match="spacing"):
        QuickSurface(0.0)
    quick = QuickSurface(1.0)
    with pytest.raises(SurfaceError, match=r"\(N, 3\), not \(4, 2\)"):
        quick.reconstruct(np.zeros((4, 2)), np.zeros((4, 4)))
    with pytest.raises(SurfaceError, match=r"\(4, 4\), not \(4, 3\)"):
        quick.reconstruct(np.zeros((4, 3)), np.zeros((4, 3)))
    monkeypatch.setattr(quick_surface, "MAX_BLOCK_COUNT", 512)
    with pytest.raises(SurfaceError, match="scattered too widely"):
        quick.reconstruct(lattice(10, 10, 10) * 100, np.ones((1000, 4)))
    check(quick.reconstruct(lattice(5, 5, 5), np.ones((125, 4))))
