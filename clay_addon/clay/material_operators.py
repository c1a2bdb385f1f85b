# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that save the active clay's material for reuse, and remove saved materials."""

from __future__ import annotations

import bpy

from ..model.clay_scene import material_of
from ..model.material_presets import CUSTOM, is_user_material
from ..model.user_materials import (
    MAX_LABEL_LENGTH,
    UserMaterialError,
    forget_user_materials,
    remove_user_material,
    save_user_material,
)


def _clay(context: bpy.types.Context) -> bpy.types.Object | None:
    item = context.object
    return item if item is not None and item.tactile_clay.role == "CLAY" else None


class CLAY_OT_material_save(bpy.types.Operator):  # noqa: N801
    """Save the active clay's material as one of your own, for use in all files"""

    bl_idname = "clay.material_save"
    bl_label = "Save Material"
    bl_options = {"REGISTER", "UNDO"}

    label: bpy.props.StringProperty(
        name="Name",
        description="Name of the material",
        maxlen=MAX_LABEL_LENGTH,
        options={"SKIP_SAVE"},
    )
    replace: bpy.props.BoolProperty(
        name="Replace",
        description="Overwrite your material of the same name",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available while clay is active."""
        return _clay(context) is not None

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for a name."""
        if not self.label:
            self.label = context.object.name
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Save the material, or report why it cannot be saved."""
        item = _clay(context)
        assert item is not None
        try:
            saved = save_user_material(self.label, material_of(item), replace=self.replace)
        except (UserMaterialError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        item.tactile_clay.material_preset = saved.name
        self.report({"INFO"}, f"Saved the material {saved.label}")
        return {"FINISHED"}


class CLAY_OT_material_remove(bpy.types.Operator):  # noqa: N801
    """Delete this material of yours; clay made of it keeps its values"""

    bl_idname = "clay.material_remove"
    bl_label = "Remove Material"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available if the active clay's material was saved by the user."""
        item = _clay(context)
        if item is None or not is_user_material(item.tactile_clay.material_preset):
            cls.poll_message_set("Choose a material that you saved")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for confirmation, as the material is removed for all .blend files."""
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Delete the material, or report why it cannot be deleted."""
        item = _clay(context)
        assert item is not None
        name = item.tactile_clay.material_preset
        users = [
            each.tactile_clay
            for each in bpy.data.objects
            if each.tactile_clay.material_preset == name and each.library is None
        ]
        choosing = [
            each.tactile_clay
            for each in bpy.data.scenes
            if each.tactile_clay.material_preset == name and each.library is None
        ]
        try:
            remove_user_material(name)
        except UserMaterialError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for properties in users:
            properties.material_preset = CUSTOM
        for properties in choosing:
            properties.property_unset("material_preset")
        return {"FINISHED"}


_CLASSES = (CLAY_OT_material_save, CLAY_OT_material_remove)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
    forget_user_materials()
