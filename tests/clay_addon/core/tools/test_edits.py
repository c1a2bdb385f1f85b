# SPDX-License-Identifier: GPL-3.0-or-later
"""Adding, taking away and painting particles."""

from itertools import pairwise

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tools.edits import MIN_DISTANCE, Edit, apply_edit, fall_off
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import SPACING, block

EMPTY = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)
RED = (1.0, 0.0, 0.0, 1.0)


def least_distance(points: np.ndarray) -> float:
    """Least distance of any two points."""
    away = np.linalg.norm(points[:, None].astype(float) - points[None], axis=2)
    np.fill_diagonal(away, np.inf)
    return float(away.min())


@pytest.mark.parametrize("spacing", [0.002, 0.003])
def test_added_clay_fills_the_sphere(spacing: float) -> None:
    """Add volume over spacing cubed particles within 2 %, all of them inside, at any spacing."""
    edit = Edit("add", (0.013, -0.021, 0.042), 0.02, color=RED)
    result = apply_edit(edit, *EMPTY, spacing)
    assert len(result.positions) == pytest.approx(4 / 3 * np.pi * (0.02 / spacing) ** 3, rel=0.02)
    assert np.linalg.norm(result.positions - edit.center, axis=1).max() < 0.02 + 1e-7
    assert (result.colors == np.array(RED, np.float32)).all()
    assert (result.kept == -1).all()


def test_added_clay_keeps_away_from_what_is_there() -> None:
    """Leave every particle where it was, and no two nearer than the least distance."""
    random = np.random.default_rng(3)
    points = (block(8) + random.uniform(-0.1, 0.1, (512, 3)) * SPACING).astype(np.float32)
    before = least_distance(points)
    colors = np.ones((len(points), 4), np.float32)
    result = apply_edit(Edit("add", (0.02, 0.0, 0.01), 0.015), points, colors, SPACING)
    assert np.array_equal(result.positions[:512], points)
    assert np.array_equal(result.kept[:512], np.arange(512))
    added = result.positions[512:]
    assert len(added) > 20
    away = np.linalg.norm(added[:, None].astype(float) - points[None], axis=2).min(1)
    assert away.min() >= MIN_DISTANCE * SPACING - 1e-8
    assert least_distance(result.positions) >= min(before, MIN_DISTANCE * SPACING) - 1e-8


def test_dabs_that_overlap_fit_together() -> None:
    """Fill two spheres that overlap with one lattice, and add nothing the second time."""
    clay = EMPTY
    centers = [(0.0, 0.0, 0.0), (0.0071, 0.0033, 0.0), (0.0, 0.0, 0.0)]
    counts = [0]
    for center in centers:
        result = apply_edit(Edit("add", center, 0.015), *clay, SPACING)
        clay = result.positions, result.colors
        counts.append(len(result.positions))
    assert counts[0] < counts[1] < counts[2] == counts[3]
    assert least_distance(clay[0]) == pytest.approx(SPACING, rel=1e-4)


def test_removal_takes_what_is_inside_and_nothing_else() -> None:
    """Remove volume over spacing cubed within 3 %, and keep all outside in their order."""
    points = block(20).astype(np.float32)
    colors = np.random.default_rng(4).random((len(points), 4)).astype(np.float32)
    center = (0.003, 0.001, -0.002)
    result = apply_edit(Edit("remove", center, 0.03), points, colors, SPACING)
    outside = np.flatnonzero(np.linalg.norm(points - np.array(center, np.float32), axis=1) >= 0.03)
    assert np.array_equal(result.kept, outside)
    assert np.array_equal(result.positions, points[outside])
    assert np.array_equal(result.colors, colors[outside])
    removed = len(points) - len(outside)
    assert removed == pytest.approx(4 / 3 * np.pi * (0.03 / SPACING) ** 3, rel=0.03)
    assert result.moves_particles


def test_paint_blends_and_fades_out() -> None:
    """Blend by strength in the middle, less towards the rim, not at all outside."""
    points = np.column_stack((np.linspace(0.0, 0.03, 31), np.zeros(31), np.zeros(31)))
    colors = np.tile(np.array((0.0, 0.4, 0.8, 1.0), np.float32), (31, 1))
    edit = Edit("paint", (0.0, 0.0, 0.0), 0.02, strength=0.5, color=RED)
    result = apply_edit(edit, points, colors, SPACING)
    assert np.array_equal(result.positions, points.astype(np.float32))
    assert not result.moves_particles
    assert np.allclose(result.colors[0], (0.5, 0.2, 0.4, 1.0))
    assert all(a >= b for a, b in pairwise(result.colors[:, 0]))
    assert np.array_equal(result.colors[21:], colors[21:])


def test_full_paint_covers() -> None:
    """Leave nothing of the old color in the middle at full strength."""
    result = apply_edit(
        Edit("paint", (0.0, 0.0, 0.0), 0.02, color=RED), block(2), np.zeros((8, 4)), SPACING
    )
    assert np.allclose(result.colors, RED)
    assert fall_off(np.array([0.0, 1.0, 2.0])).tolist() == [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "melt"}, "There are: add, remove, paint"),
        ({"radius": 0.0}, "above 0"),
        ({"radius": np.nan}, "finite"),
        ({"center": (0.0, np.inf, 0.0)}, "finite"),
        ({"strength": 1.5}, "0 to 1"),
    ],
)
def test_a_bad_edit_is_refused(values: dict, message: str) -> None:
    """Say what is wrong with an edit when it is made."""
    with pytest.raises(ValueError, match=message):
        Edit(**{"kind": "add", "center": (0.0, 0.0, 0.0), "radius": 0.01, **values})


def test_clay_of_the_wrong_shape_is_refused() -> None:
    """Say that positions and colors do not fit, or that the spacing is none."""
    edit = Edit("add", (0.0, 0.0, 0.0), 0.01)
    with pytest.raises(ValueError, match="expected"):
        apply_edit(edit, np.zeros((3, 3)), np.zeros((2, 4)), SPACING)
    with pytest.raises(ValueError, match="spacing"):
        apply_edit(edit, *EMPTY, 0.0)
