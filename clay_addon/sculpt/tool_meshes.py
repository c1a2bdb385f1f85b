# SPDX-License-Identifier: GPL-3.0-or-later
"""The meshes of the tools, sized for a brush: one that comes along, or an object of the user's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .settings import BrushSettings, ToolMesh
from .tools import Tool

WIRE_LENGTH = 1.0
"""Of a wire's mesh [m]; its pose stretches it."""
_WIRE_THICKNESS = 0.7
"""Diameter of a wire [spacings]: enough to part the clay, too little to plough it."""
FINGERS_SIZE = 0.6
"""Of the two fingers of a pinch [brush radii]."""


def tool_parts(settings: BrushSettings) -> list[ToolMesh]:
    """The meshes of a tool and no copies: two for a pinch, none for an edit.

    Args:
        settings: What the brush is set to.

    Returns:
        Meshes in metres. A pose scales them when the radius changes.
    """
    tool = settings.tool
    if tool.path == "edit":
        return []
    if tool.path == "view":
        return [_wire(settings.spacing)]
    if tool.identifier == "STAMP" and settings.stamp is not None:
        return [_sized(settings.stamp, settings.radius)]
    mesh = _preset_mesh(tool, settings)
    if tool.path == "pinch":
        finger = _sized(mesh, FINGERS_SIZE)
        return [finger, finger]
    return [mesh]


def _sized(mesh: ToolMesh, size: float) -> ToolMesh:
    return ToolMesh(mesh.vertices * size, mesh.faces, mesh.friction)


def _preset_mesh(tool: Tool, settings: BrushSettings) -> ToolMesh:
    vertices, faces = ball_mesh()
    return ToolMesh(vertices * settings.radius, faces)


def _wire(spacing: float) -> ToolMesh:
    """A straight thin rod along Z, its middle at the origin."""
    count = 10
    turn = 2.0 * np.pi * np.arange(count) / count
    circle = 0.5 * _WIRE_THICKNESS * spacing * np.column_stack((np.cos(turn), np.sin(turn)))
    low = np.column_stack((circle, np.full(count, -0.5 * WIRE_LENGTH)))
    high = np.column_stack((circle, np.full(count, 0.5 * WIRE_LENGTH)))
    here, following = np.arange(count), (np.arange(count) + 1) % count
    first, last = np.full(count, 2 * count), np.full(count, 2 * count + 1)
    faces = np.concatenate(
        (
            np.column_stack((here, following, count + following)),
            np.column_stack((here, count + following, count + here)),
            np.column_stack((first, following, here)),
            np.column_stack((last, count + here, count + following)),
        )
    )
    poles = np.array([[0.0, 0.0, -0.5 * WIRE_LENGTH], [0.0, 0.0, 0.5 * WIRE_LENGTH]])
    return ToolMesh(np.concatenate((low, high, poles)), faces.astype(np.int32))


def ball_mesh(rings: int = 12, segments: int = 24) -> tuple[NDArray, NDArray[np.int32]]:
    """A ball of radius 1 that lies on the origin, its tip there.

    Returns:
        Vertices, shape [V, 3], and triangles, shape [F, 3], wound outward.
    """
    polar = np.pi * np.arange(1, rings) / rings
    turn = 2.0 * np.pi * np.arange(segments) / segments
    body = np.stack(
        (
            np.sin(polar)[:, None] * np.cos(turn),
            np.sin(polar)[:, None] * np.sin(turn),
            np.broadcast_to(1.0 - np.cos(polar)[:, None], (rings - 1, segments)),
        ),
        axis=-1,
    ).reshape(-1, 3)
    vertices = np.concatenate((body, [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]]))
    here, following = np.arange(segments), (np.arange(segments) + 1) % segments
    bottom, top = len(body), len(body) + 1
    faces = [np.column_stack((np.full(segments, bottom), following, here))]
    for ring in range(rings - 2):
        low, high = ring * segments, (ring + 1) * segments
        faces.append(np.column_stack((low + here, low + following, high + following)))
        faces.append(np.column_stack((low + here, high + following, high + here)))
    last = (rings - 2) * segments
    faces.append(np.column_stack((last + here, last + following, np.full(segments, top))))
    return vertices, np.concatenate(faces).astype(np.int32)
