# SPDX-License-Identifier: GPL-3.0-or-later
"""Operator to export clay, with a file browser."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper

from ..core.surface.exact import SurfaceError
from .export import AUTO, MIN_WALL, SUFFIXES, ExportError, export_clay


class CLAY_OT_export(bpy.types.Operator, ExportHelper):  # noqa: N801
    """Export the clay at the current frame as one closed, colored mesh: STL, 3MF, OBJ, PLY, GLB"""

    bl_idname = "clay.export"
    bl_label = "Export Clay"

    filename_ext = ".stl"
    check_extension = None
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"}
    )
    use_selection: bpy.props.BoolProperty(
        name="Selected Only", description="Export only selected clay", default=False
    )
    unit: bpy.props.EnumProperty(
        name="Unit",
        description="Unit of the numbers in the file",
        items=(
            (AUTO, "Automatic", "Millimeters in STL and 3MF, as slicers expect, else meters"),
            ("m", "Meters", "As in Blender's own exporters"),
            ("mm", "Millimeters", "As 3D printing software expects in STL"),
        ),
        default=AUTO,
    )
    base: bpy.props.FloatProperty(
        name="Flat Base (mm)",
        description="Height to cut off at the bottom [mm] for the clay to stand on; 0 for none",
        default=0.0,
        min=0.0,
        soft_max=10.0,
    )
    wall: bpy.props.FloatProperty(
        name="Thinnest Wall (mm)",
        description="Warn about thinner walls in STL and 3MF [mm]",
        default=MIN_WALL,
        min=0.0,
        soft_max=5.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require clay in the scene."""
        from ..model.clay_scene import clay_objects

        return bool(clay_objects(context.scene))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Export the clay, or report why it cannot be exported."""
        from ..model.clay_scene import clay_objects
        from ..playback.playback import message
        from ..playback.poses import needs_no_cache

        clay = clay_objects(context.scene)
        if self.use_selection:
            clay = [item for item in clay if item in context.selected_objects]
            if not clay:
                self.report({"ERROR"}, "No clay is selected.")
                return {"CANCELLED"}
        time = context.scene.frame_current_final
        itself = all(needs_no_cache(item, time) for item in clay)
        if message(context.scene) and not itself:
            self.report({"WARNING"}, message(context.scene))
        window = None if bpy.app.background else context.window
        if window:
            window.cursor_modal_set("WAIT")
        try:
            result = export_clay(
                context,
                bpy.path.abspath(self.filepath),
                objects=clay,
                unit=self.unit,
                base=self.base,
                wall=self.wall,
            )
        except (ExportError, SurfaceError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if window:
                window.cursor_modal_restore()
        for warning in (result["print"] or {}).get("warnings", ()):
            self.report({"WARNING"}, warning)
        size = " × ".join(f"{length:.1f}" for length in result["size"])
        self.report(
            {"INFO"},
            f"{Path(result['file']).name}: {result['faces']:,} triangles, watertight, {size} mm",
        )
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(CLAY_OT_export)


def unregister() -> None:
    """Unregister the operator."""
    bpy.utils.unregister_class(CLAY_OT_export)
