# SPDX-License-Identifier: GPL-3.0-or-later
"""What the solver of a live session depends on: when it changes, the solver is rebuilt."""

from __future__ import annotations

from collections.abc import Hashable

import bpy

from ...base.units import meters_per_unit
from ...model.clay_scene import solver_settings
from ...model.material_properties import property_names

_CLAY_VALUES = (*property_names(), "spacing")


def structure(scene: bpy.types.Scene) -> Hashable:
    """A key that changes when a scene needs a new solver; cheap enough for every tick.

    It changes when objects are created, deleted, renamed, hidden or restored by Undo, when clay is
    moved or gets other points, and with materials, collider properties, gravity and settings.
    """
    parts: list[Hashable] = []
    for item in scene.objects:
        properties = item.tactile_clay
        role = properties.role
        if role == "NONE":
            continue
        parts += [item.name, item.session_uid, role, item.hide_viewport]
        if role == "CLAY" and item.type == "POINTCLOUD":
            parts += [item.data.session_uid, len(item.data.points)]
            parts += [tuple(row) for row in item.matrix_world]
            parts += [getattr(properties, name) for name in _CLAY_VALUES]
        elif role == "COLLIDER":
            parts += [properties.collider_kind, properties.collider_friction]
            parts += [properties.collider_adhesion, len(item.data.vertices)]
        elif role == "HAND":
            parts += [properties.collider_friction, len(item.data.vertices)]
    parts += [meters_per_unit(scene), scene.use_gravity, tuple(scene.gravity)]
    parts.append(solver_settings(scene))
    return tuple(parts)
