# SPDX-License-Identifier: GPL-3.0-or-later
"""The *Sculpt* panel in the sidebar's *Clay* tab."""

from __future__ import annotations

import bpy

from ..base.preferences import draw_text
from ..model.clay_scene import clay_objects
from .header import draw_brush
from .live.autosave import recovery
from .live.current import current
from .live.session import SculptSession


class CLAY_PT_sculpt(bpy.types.Panel):  # noqa: N801
    """Sculpt, record takes, and set up the brush."""

    bl_label = "Sculpt"
    bl_order = 1
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Clay"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        running = current.session
        properties = context.scene.tactile_clay
        if recovery.message:
            draw_text(layout.box(), recovery.message, icon="RECOVER_LAST")
        if running is None:
            column = layout.column()
            clay = clay_objects(context.scene)
            column.enabled = bool(clay)
            column.scale_y = 1.3
            column.operator("clay.sculpt", icon="SCULPTMODE_HLT")
            if current.clay_before:
                layout.operator("clay.sculpt_revert", icon="LOOP_BACK")
            row = layout.row(align=True)
            row.prop(properties, "record_take", icon="REC")
            row.operator("clay.take_recover", text="", icon="RECOVER_LAST")
            if any(item.tactile_clay.take_start is not None for item in clay):
                layout.operator("clay.bake_again", icon="RENDER_ANIMATION")
        else:
            column = layout.column()
            column.scale_y = 1.3
            column.operator("clay.sculpt_finish", icon="CHECKMARK")
            draw_text(layout, speed_text(running), icon="TIME")
            for message in running.messages:
                draw_text(layout.box(), message, icon="INFO")
        draw_brush(layout.column(), context.scene.tactile_clay_sculpt, compact=False)


def speed_text(running: SculptSession) -> str:
    """The speed of simulated time relative to real time, as text."""
    if not running.pace.started:
        return "Getting ready …"
    if running.factor > 0.95:
        return "Real time"
    return f"{running.factor:.0%} of real time"


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(CLAY_PT_sculpt)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(CLAY_PT_sculpt)
