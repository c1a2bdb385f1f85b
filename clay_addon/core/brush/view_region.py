# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding the 3D view under the mouse, unless it is over a panel, header or gizmo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .view_ray import View

_GIZMO_MARGIN = 12
"""Margin around the navigation gizmo [interface pixels]."""
_BUTTON = 30
"""Size of one of the round buttons below the gizmo [interface pixels]."""
_BUTTONS = 5
"""Number of those buttons."""


@dataclass(frozen=True)
class Pointer:
    """The mouse in a 3D view."""

    view: View
    """What the region shows."""
    x: float
    """Distance from the region's left edge [pixels]."""
    y: float
    """Distance from the region's lower edge [pixels]."""
    area: Any
    """The area of the view."""
    region: Any
    """The region of the view."""


def find_pointer(context: Any, mouse_x: int, mouse_y: int) -> Pointer | None:
    """The 3D view under the mouse; None over headers, panels, gizmos and other editors.

    Args:
        context: Its window is searched, including quad views.
        mouse_x: Distance from the window's left edge [pixels].
        mouse_y: Distance from the window's lower edge [pixels].
    """
    window = context.window
    if window is None:
        return None
    for area in window.screen.areas:
        if area.type != "VIEW_3D" or not _inside(area, mouse_x, mouse_y):
            continue
        for region in area.regions:
            # Closed regions have a size of 1.
            if region.type == "WINDOW" or min(region.width, region.height) <= 1:
                continue
            if _inside(region, mouse_x, mouse_y):
                return None
        for region in area.regions:
            if region.type == "WINDOW" and _inside(region, mouse_x, mouse_y):
                if _on_gizmo(context, area, region, mouse_x, mouse_y):
                    return None
                return pointer_in(context, area, region, mouse_x, mouse_y)
    return None


def pointer_in(context: Any, area: Any, region: Any, mouse_x: int, mouse_y: int) -> Pointer:
    """The mouse relative to a region, even after it has left the region during a stroke."""
    shown = region.data
    view = View(
        np.array(shown.perspective_matrix, np.float64),
        np.array(shown.view_matrix, np.float64),
        bool(shown.is_perspective),
        width=region.width,
        height=region.height,
        scale=context.scene.unit_settings.scale_length,
    )
    # Half a pixel is added to get its center.
    return Pointer(view, mouse_x - region.x + 0.5, mouse_y - region.y + 0.5, area, region)


def _inside(part: Any, x: int, y: int) -> bool:
    return bool(part.x <= x < part.x + part.width and part.y <= y < part.y + part.height)


def _on_gizmo(context: Any, area: Any, region: Any, x: int, y: int) -> bool:
    """Whether the mouse is on the navigation gizmo or the buttons below it."""
    space = area.spaces.active
    preferences = context.preferences
    if not (space.show_gizmo and space.show_gizmo_navigate):
        return False
    if preferences.view.mini_axis_type != "GIZMO":
        return False
    scale = preferences.system.ui_scale
    right, top = region.x + region.width, region.y + region.height
    for other in area.regions:
        if min(other.width, other.height) <= 1:
            continue
        # Overlapping regions cover part of the view.
        if other.type == "UI" and other.alignment == "RIGHT" and _overlap(other, region):
            right = min(right, other.x)
        if (
            other.type in ("HEADER", "TOOL_HEADER")
            and _overlap(other, region)
            and (other.alignment == "TOP")
        ):
            top = min(top, other.y)
    size = (preferences.view.gizmo_size_navigate_v3d + 2 * _GIZMO_MARGIN) * scale
    if x >= right - size and y >= top - size:
        return True
    column = (_BUTTON + 2 * _GIZMO_MARGIN) * scale
    return bool(x >= right - column and y >= top - size - _BUTTONS * _BUTTON * scale)


def _overlap(part: Any, other: Any) -> bool:
    return bool(
        part.x < other.x + other.width
        and other.x < part.x + part.width
        and part.y < other.y + other.height
        and other.y < part.y + part.height
    )
