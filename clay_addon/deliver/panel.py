# SPDX-License-Identifier: GPL-3.0-or-later
"""The Delivery panel of the Clay tab: keyed poses, held shapes, USD and Alembic files."""

from __future__ import annotations

import bpy

from ..base.activity import ActivityKind, clay_activity
from ..core.readable import duration_text
from ..model.clay_scene import clay_objects
from ..playback.pose_operators import chosen_clay
from ..playback.poses import has_poses, pose_times
from .object import delivered_object


class CLAY_PT_delivery(bpy.types.Panel):  # noqa: N801
    """Animation and delivery of the clay."""

    bl_label = "Delivery"
    bl_order = 7
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Clay"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Require clay in the scene."""
        return bool(clay_objects(context.scene))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        scene = context.scene
        properties = scene.tactile_clay
        posed = [item for item in chosen_clay(context) if has_poses(item)]
        row = layout.row(align=True)
        row.operator("clay.pose_key", icon="KEY_HLT")
        if posed:
            row.operator("clay.pose_remove", text="", icon="KEY_DEHLT")
            row = layout.row(align=True)
            row.operator("clay.pose_take", icon="SCULPTMODE_HLT")
            row.operator("clay.pose_release", text="", icon="PHYSICS")
            count = len({time for item in posed for time in pose_times(item)})
            layout.label(text=f"{count} poses keyed" if count != 1 else "1 pose keyed")
        layout.prop(properties, "hold_frames")
        layout.operator("clay.foci_empties", icon="EMPTY_DATA")
        column = layout.column()
        column.prop(properties, "delivery_kind")
        row = column.row()
        row.active = properties.delivery_kind == "usd"
        row.prop(properties, "delivery_points")
        column.prop(properties, "delivery_directory")
        running = clay_activity.progress if clay_activity.kind is ActivityKind.DELIVERY else None
        if running is not None:
            layout.progress(
                factor=running.done / max(1, running.total),
                text=f"Frame {running.frame}: {duration_text(running.seconds_left)} left",
            )
            layout.label(text="Esc stops and changes nothing", icon="INFO")
            return
        name = "USD" if properties.delivery_kind == "usd" else "Alembic"
        layout.operator("clay.deliver", text=f"Bake to {name}", icon="FILE_CACHE")
        if delivered_object(scene) is not None:
            layout.operator("clay.deliver_remove", icon="HIDE_OFF")


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(CLAY_PT_delivery)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(CLAY_PT_delivery)
