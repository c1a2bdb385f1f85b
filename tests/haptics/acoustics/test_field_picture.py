# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the sound: the plane of the palm, the pressure on it, and the colors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tactile_clay.haptics import TransducerArray, acoustic_field, solve_drive
from tactile_clay.haptics.acoustics.field_picture import field_on_plane, palm_plane, pressure_colors

UP = np.array((0.0, 0.0, 1.0))


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.integers(0, 2**16))
def test_a_flat_palm_is_found(tilt: float, lean: float, seed: int) -> None:
    """Find the center, normal and orthonormal axes of flat skin at any slope."""
    random = np.random.default_rng(seed)
    normal = np.array((tilt, lean, 2.0))
    normal /= np.linalg.norm(normal)
    center = np.array((0.1, 0.2, 0.3))
    points = center + random.uniform(-0.04, 0.04, (60, 3))
    points -= np.outer((points - center) @ normal, normal)
    middle, axes = palm_plane(points, np.ones(60), UP)
    assert middle == pytest.approx(points.mean(axis=0))
    assert axes[:, 2] == pytest.approx(normal, abs=1e-6)
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(axes) == pytest.approx(1.0)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_points_lie_across_the_sound(count: int) -> None:
    """Use the direction of the sound as the normal if the points span no plane."""
    points = np.array(((0.0, 0.0, 0.2), (0.03, 0.0, 0.21)))[:count]
    _, axes = palm_plane(points, np.zeros(count), UP)
    assert axes[:, 2] == pytest.approx(UP)
    assert axes[:, 0] == pytest.approx((1.0, 0.0, 0.0))


def test_the_picture_is_the_field() -> None:
    """Give the field at each pixel, bottom row first."""
    array = TransducerArray.preset("sonicsurface")
    drive = solve_drive(array, np.array(((0.02, 0.01, 0.2),)), np.array((900.0,)))
    values = field_on_plane(array, drive, (0.0, 0.0, 0.2), np.eye(3), size=0.1, count=50)
    row, column = np.unravel_index(np.argmax(values), values.shape)
    place = np.array(((column + 0.5) / 50 - 0.5, (row + 0.5) / 50 - 0.5, 0.0)) * 0.1
    place += (0.0, 0.0, 0.2)
    assert place == pytest.approx((0.02, 0.01, 0.2), abs=0.002)
    assert values[row, column] == pytest.approx(abs(acoustic_field(array, drive, place))[0])


def test_colors_grow_brighter() -> None:
    """Paint higher pressure brighter, from zero to beyond the largest."""
    colors = pressure_colors(np.linspace(0.0, 1500.0, 40), 1000.0)
    bright = colors[:, :3].sum(axis=1)
    assert (np.diff(bright) >= 0.0).all()
    assert colors.shape == (40, 4)
    assert (colors >= 0.0).all()
    assert (colors <= 1.0).all()
    assert np.isfinite(pressure_colors(np.zeros(3), 0.0)).all()
