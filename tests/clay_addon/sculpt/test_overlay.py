# SPDX-License-Identifier: GPL-3.0-or-later
"""Shading and rings of the drawn brush; the drawing itself needs a window."""

import numpy as np
import pytest

from tactile_clay.clay_addon.core.tools.meshes import tool_parts
from tactile_clay.clay_addon.core.tools.settings import BrushSettings
from tactile_clay.clay_addon.core.tools.tools import BY_IDENTIFIER
from tactile_clay.clay_addon.sculpt.overlay import BrushOverlay, ring_points, shaded_corners
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import Mouse


def test_normals_of_a_ball_are_smooth() -> None:
    """Point away from the ball's center, as unit vectors."""
    (ball,) = tool_parts(BrushSettings(tool=BY_IDENTIFIER["BALL"], radius=0.01))
    points, normals = shaded_corners(ball)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    low = points[:, 2] < 0.012
    out = points[low] - (0.0, 0.0, 0.01)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", out, normals[low]).min() > 0.97


def test_ring_is_perpendicular_to_the_normal() -> None:
    """Draw a circle around the point, or part of one."""
    normal = np.array((0.6, 0.0, 0.8))
    ring = ring_points(np.array((1.0, 2.0, 3.0)), normal, 0.02)
    assert np.allclose(np.linalg.norm(ring - (1.0, 2.0, 3.0), axis=1), 0.02)
    assert np.allclose((ring - (1.0, 2.0, 3.0)) @ normal, 0.0, atol=1e-12)
    half = ring_points(np.zeros(3), normal, 0.02, 0.5)
    assert np.linalg.norm(half[0] - half[-1]) == pytest.approx(0.04)
    assert np.linalg.norm(ring[0] - ring[-1]) < 1e-9


def test_tools_are_drawn_at_their_poses(mouse: Mouse) -> None:
    """Draw each mesh at its pose, and a wire without the plate that holds the clay."""
    mouse.move(0.0, 0.0)
    assert mouse.brush.drawn() == []
    (poses,) = mouse.ticks(1)
    ((_, pose, enabled),) = mouse.brush.drawn()
    assert pose is poses[0][0] and not enabled
    mouse.source.set(tool="WIRE", mirror=(True, False, False))
    (poses,) = mouse.ticks(1)
    assert len(poses) == 4
    assert [id(pose) for _, pose, _ in mouse.brush.drawn()] == [id(poses[k][0]) for k in (0, 2)]


def test_nothing_is_drawn_in_the_background(mouse: Mouse) -> None:
    """Register no draw handler without a window, and release the brush at the end."""
    overlay = BrushOverlay()
    overlay.show(mouse.brush)
    assert overlay._handle is None and overlay.brush is mouse.brush
    overlay.hide()
    overlay.hide()
    assert overlay.brush is None
