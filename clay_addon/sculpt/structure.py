# SPDX-License-Identifier: GPL-3.0-or-later
"""What a live session's solver was built for, so that it is built anew when that has changed."""

from __future__ import annotations

from collections.abc import Hashable

import bpy

from ..base.units import meters_per_unit
from ..model.clay_scene import solver_settings

_MATERIAL = ("density", "yield_stress", "viscosity", "shear_modulus", "friction", "spacing")


def structure(scene: bpy.types.Scene) -> Hashable:
    """Tell scenes apart that one solver cannot serve, at a glance and often.

    Objects that were made, deleted, renamed, hidden or brought back by Undo are seen, clay that was
    moved or given points, what it is made of, and what decides how all is simulated.
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
            parts += [getattr(properties, name) for name in _MATERIAL]
        elif role == "COLLIDER":
            parts += [properties.collider_kind, properties.collider_friction]
            parts += [properties.collider_adhesion, len(item.data.vertices)]
        elif role == "HAND":
            parts += [properties.collider_friction, len(item.data.vertices)]
    parts += [meters_per_unit(scene), scene.use_gravity, tuple(scene.gravity)]
    parts.append(solver_settings(scene))
    return tuple(parts)
