# SPDX-License-Identifier: GPL-3.0-or-later
"""Casting rays against clay given by its particles."""

import numpy as np
import pytest

from tactile_clay.clay_addon.core.brush.raycast import ParticleSurface
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import SPACING, block

RADIUS = 0.05


@pytest.fixture(scope="module")
def ball() -> ParticleSurface:
    """A ball of clay with a radius of ten spacings."""
    points = block(22)
    return ParticleSurface(points[np.linalg.norm(points, axis=1) < RADIUS], SPACING)


def test_a_box_is_hit_on_its_faces() -> None:
    """Hit a flat face within a hundredth of a spacing, wherever the ray falls."""
    surface = ParticleSurface(block(20), SPACING)
    random = np.random.default_rng(1)
    for axis in range(3):
        for sign in (-1.0, 1.0):
            out = np.zeros(3)
            out[axis] = sign
            for _ in range(20):
                # The middle of the face, away from its edges.
                target = random.uniform(-0.03, 0.03, 3)
                target[axis] = sign * 0.05
                eye = target + out + random.uniform(-0.4, 0.4, 3)
                hit = surface.hit(eye, target - eye, 0.012)
                assert hit is not None
                assert abs(hit.point[axis] * sign - 0.05) < 0.01 * SPACING
                assert hit.normal @ out > 0.9999
                assert np.allclose(eye + hit.distance * (target - eye) / np.linalg.norm(
                    target - eye), hit.point)  # fmt: skip


def test_a_ball_is_hit_from_all_sides(ball: ParticleSurface) -> None:
    """Hit a sphere of lattice points within about half a spacing, their resolution."""
    random = np.random.default_rng(2)
    for _ in range(100):
        out = random.normal(size=3)
        out /= np.linalg.norm(out)
        hit = ball.hit(out, -out, 0.015)
        assert hit is not None
        assert abs(np.linalg.norm(hit.point) - RADIUS) < 0.6 * SPACING
        assert hit.normal @ out > np.cos(np.radians(15.0))


def test_a_ray_beside_the_clay_misses(ball: ParticleSurface) -> None:
    """Miss clay that is beside the ray or behind its origin."""
    assert ball.hit((1.0, 0.06, 0.0), (-1.0, 0.0, 0.0), 0.012) is None
    assert ball.hit((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.012) is None
    assert ParticleSurface(np.zeros((0, 3)), SPACING).hit((1, 0, 0), (-1, 0, 0), 0.012) is None


def test_the_nearer_of_two_pieces_is_hit() -> None:
    """Stop at the first surface."""
    points = np.concatenate((block(4) + np.array((0.0, 0.0, 0.1)), block(4)))
    hit = ParticleSurface(points, SPACING).hit((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.012)
    assert hit is not None and abs(hit.point[2] - 0.11) < 0.1 * SPACING


def test_a_level_surface_has_no_bumps() -> None:
    """Low-pass a bump of two spacings on a plane to less than half of its height."""
    points = block(20)
    bump = np.abs(points[:, :2]).max(1) < 0.006
    top = points[bump & (points[:, 2] > 0.04)]
    surface = ParticleSurface(
        np.concatenate((points, top + np.array((0.0, 0.0, 2 * SPACING)))), SPACING
    )
    rough = surface.hit((0, 0, 1), (0, 0, -1), 0.02)
    level = surface.hit((0, 0, 1), (0, 0, -1), 0.02, level=True)
    assert rough is not None and level is not None
    assert rough.point[2] > 0.05 + 1.9 * SPACING
    assert level.point[2] < 0.05 + 0.6 * SPACING
    assert level.normal[2] > 0.99


def test_height_of_surrounding_clay() -> None:
    """Measure how high clay reaches around a point, ignoring what is too high or too far."""
    pillar = block(4) + np.array((0.02, 0.0, 0.06))
    surface = ParticleSurface(np.concatenate((block(20), pillar)), SPACING)
    up = (0.0, 0.0, 1.0)
    assert surface.height_above((0, 0, 0.05), up, 0.03, 0.1) == pytest.approx(0.02, abs=1e-6)
    assert surface.height_above((0, 0, 0.05), up, 0.005, 0.1) == 0.0
    assert surface.height_above((0, 0, 0.05), up, 0.03, 0.001) == 0.0


def test_bad_input_is_refused() -> None:
    """Say what is wrong with positions and spacing."""
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        ParticleSurface(np.zeros((4, 2)), SPACING)
    with pytest.raises(ValueError, match="spacing"):
        ParticleSurface(np.zeros((4, 3)), 0.0)
