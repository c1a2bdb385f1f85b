# SPDX-License-Identifier: GPL-3.0-or-later
"""The *Sculpt* panel in the sidebar's *Clay* tab."""

from __future__ import annotations

import bpy

from ..preferences import draw_text
from ..simulation import clay_objects
from . import session
from .header import draw_brush


class CLAY_PT_sculpt(bpy.types.Panel):  # noqa: N801
    """Working clay live."""

    bl_label = "Sculpt"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Clay"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        running = session.current
        if running is None:
            column = layout.column()
            column.enabled = bool(clay_objects(context.scene))
            column.scale_y = 1.3
            column.operator("clay.sculpt", icon="SCULPTMODE_HLT")
            if session.first:
                layout.operator("clay.sculpt_revert", icon="LOOP_BACK")
        else:
            column = layout.column()
            column.scale_y = 1.3
            column.operator("clay.sculpt_finish", icon="CHECKMARK")
            draw_text(layout, real_time_text(running.factor), icon="TIME")
        draw_brush(layout.column(), context.scene.tactile_clay_sculpt, compact=False)


def real_time_text(factor: float) -> str:
    """How fast simulated time goes by, in words; empty before any has.

    Args:
        factor: Simulated time over that of the clock.
    """
    if factor <= 0.0:
        return "Getting ready …"
    if factor > 0.95:
        return "Real time"
    return f"{factor:.0%} of real time"


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(CLAY_PT_sculpt)


def unregister() -> None:
    """Unregister it."""
    bpy.utils.unregister_class(CLAY_PT_sculpt)
