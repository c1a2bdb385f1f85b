# SPDX-License-Identifier: GPL-3.0-or-later
"""The meshes of the tools, sized for a brush: presets, or an object of the user's."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .presets import load_tool_preset
from .settings import BrushSettings, ToolMesh
from .tools import Tool

_PADS = (1.0, 1.5, 1.0)
"""Pinching fingers are broad like the pads of thumb and finger, so that clay stays between them."""
WIRE_LENGTH = 1.0
"""Length of a wire's mesh [m]; its pose stretches it."""
_WIRE_THICKNESS = 0.9
"""Diameter of a wire [spacings]: a thinner one no longer cuts cleanly; see the presets."""


def tool_parts(settings: BrushSettings) -> list[ToolMesh]:
    """The meshes of a tool and no copies: two for a pinch, none for an edit.

    One that is held against has a plate after it.

    Args:
        settings: What the brush is set to.

    Returns:
        Meshes in meters. A pose scales them when the radius changes.
    """
    tool = settings.tool
    if tool.path == "edit":
        return []
    if tool.path == "view":
        return [_wire(settings.spacing), _fence()]
    preset = settings.stamp if tool.identifier == "STAMP" else None
    if preset is None:
        assert tool.preset is not None
        preset = _preset(tool.preset)
    vertices = preset.fitted(tool.size * settings.radius, settings.spacing)
    if tool.path == "pinch":
        vertices = vertices * _PADS
    friction = preset.friction if tool.friction is None else tool.friction
    mesh = ToolMesh(vertices, preset.faces, friction)
    if tool.held:
        return [mesh, _fence()]
    return [mesh, mesh] if tool.path == "pinch" else [mesh]


def is_thin(tool: Tool) -> bool:
    """Whether a tool has a blade, whose thickness depends on the spacing and not on the radius."""
    return tool.preset is not None and _preset(tool.preset).thickness > 0.0


def sole_radius(parts: list[ToolMesh], radius: float) -> float:
    """How far a tool reaches sideways near the clay [m].

    Args:
        parts: What `tool_parts` gave, without a plate.
        radius: Of the brush that they were made for [m].
    """
    reach = radius
    for mesh in parts:
        low = mesh.vertices[mesh.vertices[:, 2] < radius]
        reach = max(reach, float(np.hypot(low[:, 0], low[:, 1]).max(initial=0.0)))
    return reach


_preset = lru_cache(load_tool_preset)


def is_aligned(tool: Tool) -> bool:
    """Whether the direction of the stroke must be known before the tool meets the clay."""
    if tool.held:
        return True
    return tool.preset is not None and _preset(tool.preset).align == "stroke"


def _fence() -> ToolMesh:
    """A plate that holds the clay on the far side of a blade.

    A box of 1 m, the middle of its upper side at the origin; its pose sizes it.
    """
    corners = np.array([(x, y, z) for z in (-1.0, 0.0) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    faces = [
        (0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4),
        (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2), (1, 3, 7), (1, 7, 5),
    ]  # fmt: skip
    return ToolMesh(corners, np.array(faces, np.int32))


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
    return ToolMesh(np.concatenate((low, high, poles)), faces.astype(np.int32), friction=0.0)
