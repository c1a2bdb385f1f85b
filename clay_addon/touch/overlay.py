# SPDX-License-Identifier: GPL-3.0-or-later
"""Overlay of the 3D Viewport: focal points, and their pressure on the skin."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
from numpy.typing import NDArray

from ..base.app_handlers import ViewDrawing
from ..base.units import meters_per_unit
from .connection import touch

if TYPE_CHECKING:
    from ...haptics import Foci
    from ...haptics.foci.pipeline import TouchFrame

_SEGMENTS = 32
_SKIN_SIZE = 6.0
"""Size of a skin point [pixels]."""
_MIN_PRESSURE = 0.03
"""Minimum pressure for skin to be drawn, relative to the ceiling."""


def focus_rings(
    foci: Foci, normal: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A ring with radius sigma around each focal point, perpendicular to the sound.

    Args:
        foci: The focal points.
        normal: Direction of the sound, shape [3].

    Returns:
        Ends of lines for the rings [m], shape [K, 2 S, 3], and corners of triangles that fill them
        [m], shape [K, 3 S, 3].
    """
    seed = np.eye(3)[np.argmin(np.abs(normal))]
    right = np.cross(seed, normal)
    right /= np.linalg.norm(right)
    up = np.cross(normal, right)
    angle = 2.0 * np.pi * np.arange(_SEGMENTS + 1) / _SEGMENTS
    rim = foci.sigma * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up)
    points = foci.positions[:, None] + rim
    lines = np.stack((points[:, :-1], points[:, 1:]), axis=2)
    middles = np.broadcast_to(foci.positions[:, None], points[:, 1:].shape)
    triangles = np.stack((middles, points[:, :-1], points[:, 1:]), axis=2)
    return (
        lines.reshape(foci.count, -1, 3).astype(np.float32),
        triangles.reshape(foci.count, -1, 3).astype(np.float32),
    )


def draw_frame(
    frame: TouchFrame, normal: NDArray[np.float64], *, scale: float, ceiling: float
) -> None:
    """Draw a frame with the current matrices of the GPU module.

    Args:
        frame: The frame.
        normal: Direction of the sound, shape [3].
        scale: Meters per Blender unit.
        ceiling: Pressure of the brightest color [Pa].
    """
    import gpu
    from gpu_extras.batch import batch_for_shader

    from ...haptics.acoustics.field_picture import pressure_colors

    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    if frame.skin is not None and frame.reconstructed is not None:
        visible = frame.reconstructed > _MIN_PRESSURE * ceiling
        if visible.any():
            shader = gpu.shader.from_builtin("POINT_FLAT_COLOR")
            colors = pressure_colors(frame.reconstructed[visible], ceiling)
            # Low pressure is transparent, because its dark color would blacken the hand.
            colors[:, 3] = np.minimum(1.5 * frame.reconstructed[visible] / ceiling, 0.9)
            points = (frame.skin[visible] / scale).astype(np.float32)
            gpu.state.point_size_set(_SKIN_SIZE)
            batch_for_shader(shader, "POINTS", {"pos": points, "color": colors}).draw(shader)
    if frame.foci.count:
        shader = gpu.shader.from_builtin("FLAT_COLOR")
        lines, triangles = focus_rings(frame.foci, normal)
        colors = pressure_colors(frame.foci.pressures, ceiling)
        # Draw in front of the hand, because focal points lie on or below its surface.
        gpu.state.depth_test_set("NONE")
        gpu.state.line_width_set(2.0)
        for kind, places, alpha, white in (
            ("TRIS", triangles, 0.6, 0.0),
            ("LINES", lines, 1.0, 0.6),
        ):
            painted = white + (1.0 - white) * colors
            painted[:, 3] = alpha
            batch_for_shader(
                shader,
                kind,
                {
                    "pos": (places / np.float32(scale)).reshape(-1, 3),
                    "color": np.repeat(painted, places.shape[1], axis=0),
                },
            ).draw(shader)
    gpu.state.line_width_set(1.0)
    gpu.state.point_size_set(1.0)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


def _draw() -> None:
    scene = bpy.context.scene
    frame = touch.shown
    if frame is None or scene is None or not scene.tactile_touch.show_overlay:
        return
    item = scene.tactile_touch.array
    matrix = np.eye(4) if item is None else np.array(item.matrix_world, np.float64)
    normal = matrix[:3, 2] / max(float(np.linalg.norm(matrix[:3, 2])), 1e-12)
    draw_frame(
        frame,
        normal,
        scale=meters_per_unit(scene),
        ceiling=scene.tactile_touch.ceiling,
    )


_drawing = ViewDrawing(_draw)


def register() -> None:
    """Draw over every 3D Viewport; does nothing in background mode."""
    _drawing.start()


def unregister() -> None:
    """Stop drawing."""
    _drawing.stop()
