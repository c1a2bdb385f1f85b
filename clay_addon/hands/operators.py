# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators Make Clay Hand, Remove Clay Hand and Add Clay Hand."""

from __future__ import annotations

import bpy
from mathutils import Matrix

from ...solver.hand.proportions import REFERENCE_LENGTH
from ..base.units import from_meters
from .add_hand import AddHandError, add_hand
from .changes import changed_part
from .gap import SkinGap, skin_gap
from .hand import binding_of, keep_binding, remove_hand
from .reading import HandError, skinned_hand
from .store import StoredHand

_GAP = 0.75
"""Distance from the 3D cursor to each of two hands, in lengths of a hand."""


def _chosen(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Meshes deformed by selected armatures, and all other selected objects except armatures."""
    selected = list(context.selected_objects)
    deformed = [
        item
        for item in context.view_layer.objects
        if item.type == "MESH"
        and any(m.type == "ARMATURE" and m.object in selected for m in item.modifiers)
    ]
    others = [item for item in selected if item.type != "ARMATURE" and item not in deformed]
    return [*deformed, *others]


class CLAY_OT_hand_make(bpy.types.Operator):  # noqa: N801
    """Bind the selected rigged meshes, so that they shape the clay as soft hands"""

    bl_idname = "clay.hand_make"
    bl_label = "Make Clay Hand"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Bind all selected meshes; or none, and report why one cannot be bound."""
        chosen = _chosen(context)
        if not chosen:
            self.report({"ERROR"}, "Nothing is selected. Select a rigged hand first.")
            return {"CANCELLED"}
        try:
            bindings = _bindings(context, chosen)
            gaps = _gaps(context, chosen, bindings)
        except HandError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        # Nothing is changed before all that may fail is done.
        for item, gap in zip(chosen, gaps, strict=True):
            keep_binding(item, bindings[item.data.name])
            self._tell_gap(item, gap)
        return {"FINISHED"}

    def _tell_gap(self, item: bpy.types.Object, gap: SkinGap | None) -> None:
        if gap is not None and gap.too_large:
            self.report({"WARNING"}, gap.warning(item.name))
        elif gap is not None:
            self.report(
                {"INFO"},
                f"The flesh of {item.name!r} is within {gap.meters * 1e3:.2g} mm of the mesh shown",
            )


def _bindings(context: bpy.types.Context, chosen: list[bpy.types.Object]) -> dict[str, StoredHand]:
    """Bind meshes without changing them.

    Returns:
        The binding of each mesh by the name of its data; the last object's where several share it.

    Raises:
        HandError: One cannot be bound, or objects that share a mesh cannot share its binding.
    """
    # Reading is fast, so that most faults are told before any mesh is bound.
    for item in chosen:
        skinned_hand(context, item)
    bindings = {item.data.name: binding_of(context, item) for item in chosen}
    users = {item.data.name: item for item in chosen}
    for item in chosen:
        user = users[item.data.name]
        change = "" if user == item else changed_part(context, item, bindings[item.data.name])
        if change:
            raise HandError(
                f"{item.name!r} shares its mesh with {user.name!r}, but not its binding: {change}. "
                "Give it a mesh of its own (Object > Relations > Make Single User)."
            )
    return bindings


def _gaps(
    context: bpy.types.Context,
    chosen: list[bpy.types.Object],
    bindings: dict[str, StoredHand],
) -> list[SkinGap | None]:
    """How far the flesh of each would lie from the mesh that is shown.

    Raises:
        HandError: The pose of one cannot be read.
    """
    depsgraph = context.evaluated_depsgraph_get()
    return [skin_gap(item, bindings[item.data.name].rig, depsgraph) for item in chosen]


class CLAY_OT_hand_remove(bpy.types.Operator):  # noqa: N801
    """Stop the selected hands from shaping the clay; meshes and armatures are kept"""

    bl_idname = "clay.hand_remove"
    bl_label = "Remove Clay Hand"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the bindings of all selected hands."""
        hands = [item for item in _chosen(context) if item.tactile_clay.role == "HAND"]
        if not hands:
            self.report({"ERROR"}, "No clay hand is selected.")
            return {"CANCELLED"}
        for item in hands:
            remove_hand(item)
        return {"FINISHED"}


class CLAY_OT_hand_add(bpy.types.Operator):  # noqa: N801
    """Add a hand that shapes the clay, with an armature for tracking or keyframes"""

    bl_idname = "clay.hand_add"
    bl_label = "Add Clay Hand"
    bl_options = {"REGISTER", "UNDO"}

    side: bpy.props.EnumProperty(
        name="Side",
        items=(
            ("LEFT", "Left", "A left hand"),
            ("RIGHT", "Right", "A right hand"),
            ("BOTH", "Both", "A left and a right hand"),
        ),
        default="RIGHT",
    )
    length: bpy.props.FloatProperty(
        name="Length (m)",
        description="Distance from the wrist to the tip of the straight middle finger [m]",
        default=REFERENCE_LENGTH,
        min=0.02,
        soft_min=0.10,
        soft_max=0.25,
        max=2.0,
        precision=3,
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Add the hands at the 3D cursor."""
        if context.mode != "OBJECT":
            self.report({"ERROR"}, "Hands can only be added in Object Mode. Switch to it first.")
            return {"CANCELLED"}
        sides = {"LEFT": ("left",), "RIGHT": ("right",), "BOTH": ("left", "right")}[self.side]
        gap = from_meters(context.scene, _GAP * self.length)
        try:
            for side in sides:
                offset = 0.0 if len(sides) == 1 else gap if side == "right" else -gap
                matrix = context.scene.cursor.matrix @ Matrix.Translation((offset, 0.0, 0.0))
                add_hand(context, side, length=self.length, matrix=matrix)
        except (AddHandError, HandError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


_CLASSES = (CLAY_OT_hand_make, CLAY_OT_hand_remove, CLAY_OT_hand_add)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
