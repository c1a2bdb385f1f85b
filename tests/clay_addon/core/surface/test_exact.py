# SPDX-License-Identifier: GPL-3.0-or-later
"""The reconstructed surface is closed and smooth, with the right volume and colors."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tactile_clay.clay_addon.core.surface.exact import (
    Surface,
    SurfaceError,
    check_closed_manifold,
    connected_components,
    reconstruct,
)
from tactile_clay.clay_addon.core.surface.particle_grid import ParticleGrid


def lattice(*counts: int) -> np.ndarray:
    """Particles of a block, one unit apart, centered."""
    axes = [np.arange(count) - (count - 1) / 2 for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def ball(radius: float) -> np.ndarray:
    """Particles of a ball, one unit apart, slightly disordered."""
    points = lattice(*[2 * int(radius) + 3] * 3)
    points = points[np.linalg.norm(points, axis=1) < radius]
    return points + np.random.default_rng(1).normal(0, 0.03, points.shape)


def moved(points: np.ndarray, distance: float) -> np.ndarray:
    """The particles shifted along x."""
    return points + np.array([distance, 0, 0])


def assert_shippable(surface: Surface, volume: float, *, tolerance: float = 0.003) -> None:
    """Check what must hold for every exported mesh, with our own check and with trimesh."""
    surface.check()
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert np.isfinite(surface.vertices).all()
    assert mesh.volume > 0
    assert surface.volume == pytest.approx(volume, rel=tolerance)
    # It must still hold after rounding to a file's float32.
    local = (surface.vertices - surface.vertices.mean(axis=0)) / np.cbrt(volume)
    merged = trimesh.Trimesh(local.astype(np.float32), surface.faces, process=True)
    assert merged.is_watertight


SHAPES = {
    "ball": ball(7),
    "block": lattice(12, 10, 8),
    "sheet": lattice(20, 20, 1),
    "double sheet": lattice(20, 20, 2),
    "rod": lattice(30, 1, 1),
    "grain": np.zeros((1, 3)),
    "pieces": np.concatenate([lattice(6, 6, 6), moved(ball(4), 15), [[0, 0, 12.0]]]),
    "touching": np.concatenate([ball(5), moved(ball(5), 9.8)]),
    "hollow": lattice(14, 14, 14)[np.abs(lattice(14, 14, 14)).max(axis=1) > 3.6],
    "torn": ball(5) * [1.6, 1, 1],
    "squeezed": ball(7) * 0.6,
    "squashed": ball(7) * [1, 1, 0.6],
    "coincident": np.zeros((50, 3)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_mesh_is_closed_and_of_the_particles_volume(name: str) -> None:
    """Make a closed mesh with a volume of N d^3 within 0.3 % for every kind of clay."""
    points = SHAPES[name]
    assert_shippable(reconstruct(points, 1.0), len(points))


@pytest.mark.parametrize("spacing", [1e-4, 0.005, 3.0, 100.0])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_scale_and_place_do_not_matter(spacing: float, offset: float) -> None:
    """Make the same mesh in units of the spacing, from 0.1 mm to 100 m."""
    points = ball(4)
    reference = reconstruct(points, 1.0)
    elsewhere = reconstruct((points + offset) * spacing, spacing)
    assert_shippable(elsewhere, len(points) * spacing**3)
    local = elsewhere.vertices / spacing - offset
    distance = np.linalg.norm(local[:, None] - reference.vertices, axis=2).min(axis=1)
    assert distance.max() < 0.01


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
@given(
    count=st.one_of(st.integers(1, 60), st.integers(1, 1500)),
    density=st.floats(0.02, 40.0),
    grain=st.sampled_from([0.0, 0.25, 0.5, 1.0]),
    flatten=st.sampled_from([0.0, 0.1, 1.0]),
    seed=st.integers(0, 2**32 - 1),
)
def test_random_clouds_never_give_a_broken_mesh(
    count: int, density: float, grain: float, flatten: float, seed: int
) -> None:
    """Make a closed mesh for clouds of any density, on a lattice or not, flat or not."""
    points = np.random.default_rng(seed).uniform(0, 1, (count, 3)) * np.cbrt(count / density)
    if grain:
        points = np.round(points / grain) * grain
    points[:, 2] *= flatten
    assert_shippable(reconstruct(points, 1.0), count, tolerance=0.01)


@pytest.mark.parametrize("density", [0.1, 0.6, 1.0, 1.4, 1.8, 3.0])
@pytest.mark.parametrize("grain", [0.0, 0.5, 1.0])
def test_large_random_clouds_give_a_closed_mesh(density: float, grain: float) -> None:
    """Make a closed mesh for thousands of random particles, from sparse to overfull.

    Around 1.5 particles per cell, smoothing collapses voids; their remains must not be mistaken for
    clay.
    """
    points = np.random.default_rng(5).uniform(0, np.cbrt(3000 / density), (3000, 3))
    if grain:
        points = np.round(points / grain) * grain
    assert_shippable(reconstruct(points, 1.0), 3000, tolerance=0.01)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    points=st.lists(
        st.tuples(*[st.floats(-5, 5, allow_subnormal=False)] * 3), min_size=1, max_size=12
    )
)
def test_few_particles_anywhere_give_a_closed_mesh(
    points: list[tuple[float, float, float]],
) -> None:
    """Make a closed mesh with the right volume for a few particles in any arrangement."""
    assert_shippable(reconstruct(points, 1.0), len(points), tolerance=0.01)


def test_each_piece_has_the_volume_of_its_particles() -> None:
    """Give a block, a ball and a single grain the volume of their own particles."""
    points = SHAPES["pieces"]
    surface = reconstruct(points, 1.0)
    label = connected_components(
        len(surface.vertices), surface.faces.ravel(), np.roll(surface.faces, -1, axis=1).ravel()
    )
    pieces = np.unique(label)
    volumes = sorted(
        abs(Surface(surface.vertices, surface.faces[label[surface.faces[:, 0]] == piece]).volume)
        for piece in pieces
    )
    assert volumes == pytest.approx([1, 216, len(points) - 217], rel=0.003)


def test_bodies_that_touch_become_one_shell() -> None:
    """Make one shell of two balls pressed together, and two of separate ones."""

    def shell_count(gap: float) -> int:
        surface = reconstruct(np.concatenate([ball(5), moved(ball(5), 10 + gap)]), 1.0)
        faces = surface.faces
        label = connected_components(
            len(surface.vertices), faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        )
        return len(np.unique(label))

    assert shell_count(-0.2) == 1
    assert shell_count(1.5) == 2


def test_hollow_stays_hollow_and_small_voids_are_filled() -> None:
    """Keep a hollow of eight spacings, and fill voids where a few particles are missing."""
    hollow = reconstruct(SHAPES["hollow"], 1.0)
    inner = np.abs(hollow.vertices).max(axis=1) < 5.5
    assert inner.any()
    wall = hollow.vertices[inner & (np.abs(hollow.vertices[:, 1:]) < 1.5).all(axis=1)]
    assert np.abs(wall[:, 0]).mean() == pytest.approx(4, abs=0.15)

    block = lattice(9, 9, 9)
    pitted = block[np.linalg.norm(block, axis=1) > 1.1]
    assert len(block) - len(pitted) == 7
    surface = reconstruct(pitted, 1.0)
    assert np.abs(surface.vertices).max(axis=1).min() > 3
    assert_shippable(surface, len(pitted))


def test_surface_is_smooth_and_keeps_edges() -> None:
    """Keep bumps below 0.03 d on a flat face, and cut edges by less than 0.65 d."""
    surface = reconstruct(
        lattice(12, 12, 12) + np.random.default_rng(2).normal(0, 0.05, (1728, 3)), 1.0
    )
    middle = (np.abs(surface.vertices[:, :2]) < 3.5).all(axis=1) & (surface.vertices[:, 2] > 4)
    assert surface.vertices[middle, 2].std() < 0.03
    assert surface.vertices[middle, 2].mean() == pytest.approx(6, abs=0.15)
    to_edge = np.linalg.norm(surface.vertices[:, [0, 2]] - 6, axis=1)
    assert to_edge[np.abs(surface.vertices[:, 1]) < 3].min() < 0.65


def test_more_smoothing_makes_the_surface_smoother() -> None:
    """Lower the steps of a ball cut from a lattice with more smoothing passes."""
    points = lattice(17, 17, 17)
    points = points[np.linalg.norm(points, axis=1) < 8]
    spread = [
        np.linalg.norm(reconstruct(points, 1.0, smoothing=passes).vertices, axis=1).std()
        for passes in (0, 20, 60)
    ]
    assert spread[0] > 1.2 * spread[1] > 1.2 * spread[2]
    assert spread[1] < 0.12


def test_colors_meet_in_a_narrow_border() -> None:
    """Keep colors pure beyond 0.9 d from the border between two of them."""
    points = lattice(16, 8, 8)
    red, blue = (0.8, 0.05, 0.02, 1.0), (0.02, 0.1, 0.7, 1.0)
    surface = reconstruct(points, 1.0, colors=np.where(points[:, :1] < 0, red, blue))
    assert surface.colors is not None
    assert surface.colors.dtype == np.float32
    x = surface.vertices[:, 0]
    np.testing.assert_allclose(
        surface.colors[x < -0.9], np.broadcast_to(red, (sum(x < -0.9), 4)), atol=0.01
    )
    np.testing.assert_allclose(
        surface.colors[x > 0.9], np.broadcast_to(blue, (sum(x > 0.9), 4)), atol=0.01
    )


def test_colors_stay_within_those_of_the_particles() -> None:
    """Keep vertex colors within the range of the particles' colors."""
    colors = np.random.default_rng(3).uniform(0.2, 0.6, (len(SHAPES["torn"]), 4))
    tint = reconstruct(SHAPES["torn"], 1.0, colors=colors).colors
    assert tint is not None
    assert tint.min() >= colors.min() - 1e-6
    assert tint.max() <= colors.max() + 1e-6


def test_the_same_particles_give_the_same_mesh() -> None:
    """Make the same number of vertices and the same volume twice."""
    first, second = (reconstruct(SHAPES["touching"], 1.0) for _ in range(2))
    assert len(first.vertices) == len(second.vertices)
    assert first.volume == pytest.approx(second.volume, rel=1e-6)


@pytest.mark.parametrize(
    ("positions", "spacing", "colors", "message"),
    [
        (np.empty((0, 3)), 1.0, None, "no particles"),
        (np.zeros((4, 2)), 1.0, None, r"shape \(N, 3\)"),
        ([[0, 0, np.nan], [1, 0, 0]], 1.0, None, "1 of 2 particles"),
        ([[0, np.inf, 0]], 1.0, None, "not finite"),
        ([[0, 0, 0]], 0.0, None, "spacing"),
        ([[0, 0, 0]], float("nan"), None, "spacing"),
        ([[0, 0, 0]], 1.0, [[1, 0, 0]], r"shape \(1, 4\)"),
        ([[0, 0, 0]], 1.0, [[1, 0, np.nan, 1]], "color"),
        ([[0, 0, 0], [1e6, 0, 0]], 1.0, None, "spread over 1e\\+06 spacings"),
    ],
)
def test_bad_input_is_named(
    positions: object, spacing: float, colors: object, message: str
) -> None:
    """Refuse input that has no surface, and say what is wrong with it."""
    with pytest.raises(SurfaceError, match=message):
        reconstruct(positions, spacing, colors=colors)  # type: ignore[arg-type]


def test_negative_smoothing_is_refused() -> None:
    """Refuse a negative number of smoothing passes."""
    with pytest.raises(SurfaceError, match="smoothing"):
        reconstruct([[0, 0, 0]], 1.0, smoothing=-1)


TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        (TETRAHEDRON[:0], "empty"),
        (TETRAHEDRON[:3], "3 edges without a partner"),
        (np.concatenate([TETRAHEDRON[:3], TETRAHEDRON[3:, ::-1]]), "3 repeated"),
        (np.concatenate([TETRAHEDRON, TETRAHEDRON]), "12 repeated"),
        (np.concatenate([TETRAHEDRON, [[3, 3, 3]]]), "3 edges of zero length"),
        (np.concatenate([TETRAHEDRON, np.array([0, 4, 5, 6])[TETRAHEDRON]]), "1 vertices"),
    ],
)
def test_check_finds_faults(faces: np.ndarray, message: str) -> None:
    """Find and count holes, flipped and doubled faces, and pinched vertices."""
    check_closed_manifold(TETRAHEDRON, 4)
    with pytest.raises(SurfaceError, match=message):
        check_closed_manifold(faces, 7)


def test_nearest_particle_agrees_with_brute_force() -> None:
    """Find the nearest particle, and none beyond the cell size."""
    rng = np.random.default_rng(4)
    points, queries = rng.uniform(0, 6, (300, 3)), rng.uniform(-2, 8, (500, 3))
    distance = np.linalg.norm(queries[:, None] - points, axis=2)
    expected = np.where(distance.min(axis=1) < 1, distance.argmin(axis=1), -1)
    np.testing.assert_array_equal(ParticleGrid(points, 1.0).nearest(queries), expected)


def test_labels_spread_through_connected_particles_only() -> None:
    """Propagate a label to every particle of its own body and to none of another."""
    points = np.concatenate([lattice(9, 3, 3), moved(lattice(9, 3, 3), 30)])
    labels = np.full(len(points), -1)
    labels[0] = 7
    spread = ParticleGrid(points, 1.5).spread(labels)
    assert (spread[:81] == 7).all()
    assert (spread[81:] == -1).all()
