# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake Again and Recover Take as operators."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..base.activity import BusyError, clay_activity
from ..core.storage.cache import CacheError
from ..core.take.files import is_take
from .film import FilmError, make_film
from .store import store_take


class CLAY_OT_bake_again(bpy.types.Operator):  # noqa: N801
    """Bake the recorded take with finer clay, in a separate scene for rendering"""

    bl_idname = "clay.bake_again"
    bl_label = "Bake Again"
    # Not REGISTER: repeating it would delete what is being baked.
    bl_options = {"UNDO"}

    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description=(
            "Particle spacing of the film; 0 for half of the live spacing, which shows twice the "
            "detail and takes about ten times as long"
        ),
        subtype="DISTANCE",
        unit="LENGTH",
        min=0.0,
        precision=4,
        options={"SKIP_SAVE"},
    )
    substeps: bpy.props.IntProperty(
        name="Substeps",
        description="Solver steps per sixtieth of a second; 0 lets the solver choose",
        min=0,
        max=4096,
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the spacing."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make the film scene, switch to it and bake; in the interface, one frame at a time."""
        window = context.window
        if window is not None and not bpy.app.background:
            window.cursor_modal_set("WAIT")
        try:
            clay_activity.check_free()
            film = make_film(context, spacing=self.spacing, substeps=self.substeps)
        except (BusyError, FilmError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if window is not None and not bpy.app.background:
                window.cursor_modal_restore()
        try:
            if window is None:
                with context.temp_override(scene=film, view_layer=film.view_layers[0]):
                    bpy.ops.clay.bake()
            else:
                window.scene = film
                bpy.ops.clay.bake("INVOKE_DEFAULT")
        except RuntimeError as error:
            # Keep the scene: Bake can be pressed there once the problem is fixed.
            self.report({"ERROR"}, str(error).strip().removeprefix("Error: "))
        return {"FINISHED"}


class CLAY_OT_take_recover(bpy.types.Operator):  # noqa: N801
    """Put an interrupted or earlier take on the timeline"""

    bl_idname = "clay.take_recover"
    bl_label = "Recover Take"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(
        name="Folder",
        description="Folder of the take, such as clay_cache_take_001",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the folder."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the take and put it on the timeline."""
        folder = Path(bpy.path.abspath(self.directory))
        if not is_take(folder):
            self.report({"ERROR"}, f"There is no take in {folder}. Choose the folder of a take.")
            return {"CANCELLED"}
        try:
            stored = store_take(context.scene, folder)
        except CacheError as error:
            self.report({"ERROR"}, f"The take cannot be recovered: {error}.")
            return {"CANCELLED"}
        for warning in stored.warnings:
            self.report({"WARNING"}, warning)
        self.report({"INFO"}, f"Take on frames {stored.first} to {stored.last}")
        return {"FINISHED"}


_CLASSES = (CLAY_OT_bake_again, CLAY_OT_take_recover)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
