# SPDX-License-Identifier: GPL-3.0-or-later
"""Colliders: meshes that press on the clay."""

import bpy
import numpy as np

from ...solver.core.errors import TactileClayError
from ...solver.geometry.closed_mesh import MeshError, check_closed_mesh
from ..base.mesh_geometry import (
    SWITCHED_OFF,
    evaluated_mesh,
    flat_plane,
    is_switched_off,
    transform,
)

TAKE_TOOL = "clay_take_tool"
"""Custom property of colliders that replay a tool of a recorded take."""


class ColliderError(TactileClayError):
    """An object cannot be a collider; the message says why and what to do."""


def make_collider(
    item: bpy.types.Object, kind: str = "AUTO", friction: float = 0.5
) -> bpy.types.Object:
    """Mark a mesh object as a collider; its transform and modifiers may be animated.

    Args:
        item: A mesh object. A flat one can be an endless plane, any other must be closed.
        kind: ``AUTO``, ``MESH`` or ``PLANE``.
        friction: Coulomb friction coefficient.

    Raises:
        ColliderError: The object is not a mesh, open, a clay hand, linked from another file, or
            not of the requested kind; it is left unchanged.
    """
    if friction < 0 or not np.isfinite(friction):
        raise ColliderError(f"The friction is {friction!r}; it must be finite and at least 0.")
    if kind not in ("AUTO", "MESH", "PLANE"):
        raise ColliderError(f"There is no collider kind {kind!r}. Choose AUTO, MESH or PLANE.")
    _check_may_be_collider(item)
    resolve_kind(item, kind, bpy.context.evaluated_depsgraph_get())
    properties = item.tactile_clay
    properties.role = "COLLIDER"
    properties.collider_kind = kind
    properties.collider_friction = friction
    return item


def _check_may_be_collider(item: bpy.types.Object) -> None:
    if item.tactile_clay.role == "HAND":
        raise ColliderError(
            f"{item.name!r} is a clay hand, which already works the clay. To make it a collider, "
            "press Remove Clay Hand first."
        )
    if item.library is not None:
        raise ColliderError(
            f"{item.name!r} is linked from another file, so this file cannot save that it is a "
            "collider. Make it local (Object > Relations > Make Local), or make it a collider "
            "in that file."
        )


def resolve_kind(item: bpy.types.Object, kind: str, depsgraph: bpy.types.Depsgraph) -> str:
    """Resolve ``AUTO`` to ``PLANE`` or ``MESH``, and check that an object can be that.

    Raises:
        ColliderError: It cannot be a collider, or not of the requested kind.
    """
    if item.type != "MESH":
        raise ColliderError(
            f"{item.name!r} is not a mesh ({item.type.lower()}), so it cannot be a collider."
        )
    if is_switched_off(item, depsgraph):
        raise ColliderError(f"{item.name!r} {SWITCHED_OFF}")
    vertices, triangles = evaluated_mesh(item, depsgraph)
    vertices = transform(item.evaluated_get(depsgraph).matrix_world, vertices)
    flat = flat_plane(vertices) is not None
    if kind == "PLANE" and not flat:
        raise ColliderError(f"{item.name!r} is not flat, so it cannot be an infinite plane.")
    if kind == "PLANE" or (kind == "AUTO" and flat):
        return "PLANE"
    try:
        check_closed_mesh(vertices, triangles, name=repr(item.name))
    except MeshError as error:
        raise ColliderError(str(error)) from error
    return "MESH"


class CLAY_OT_collider_add(bpy.types.Operator):  # noqa: N801
    """Make the selected meshes press on the clay; they may be animated"""

    bl_idname = "clay.collider_add"
    bl_label = "Make Collider"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Mark all selected objects; if one cannot be a collider, mark none and report why."""
        chosen = list(context.selected_objects)
        if not chosen:
            self.report({"ERROR"}, "Nothing is selected. Select one or more meshes first.")
            return {"CANCELLED"}
        depsgraph = context.evaluated_depsgraph_get()
        try:
            for item in chosen:
                _check_may_be_collider(item)
                resolve_kind(item, "AUTO", depsgraph)
            for item in chosen:
                make_collider(item, "AUTO", item.tactile_clay.collider_friction)
        except ColliderError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class CLAY_OT_collider_remove(bpy.types.Operator):  # noqa: N801
    """Stop the selected objects from pressing on the clay"""

    bl_idname = "clay.collider_remove"
    bl_label = "Remove Collider"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Unmark all selected colliders."""
        colliders = [
            item for item in context.selected_objects if item.tactile_clay.role == "COLLIDER"
        ]
        if not colliders:
            self.report({"ERROR"}, "No collider is selected.")
            return {"CANCELLED"}
        for item in colliders:
            item.tactile_clay.role = "NONE"
        return {"FINISHED"}


_CLASSES = (CLAY_OT_collider_add, CLAY_OT_collider_remove)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
