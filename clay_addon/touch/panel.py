# SPDX-License-Identifier: GPL-3.0-or-later
"""The *Touch* panel: the array, its device, the status and the settings."""

from __future__ import annotations

import bpy

from ..base.preferences import draw_text
from .connection import missing_touch_package, touch

_DEVICE_PROPERTIES = {
    "SONICSURFACE": ("port", "firmware"),
    "ULTRAINO": ("port", "board"),
    "OPENMPD": ("board_file",),
    "AUTD3": ("interface",),
    "STRATOS_EXPLORE": ("bridge",),
    "SERVER": ("server_port",),
}
"""Properties that each kind of device needs."""


def status_lines() -> list[tuple[str, str]]:
    """The status of the array, as lines of text with icons."""
    status = touch.status
    if touch.client is None:
        return []
    if status is None or not status.heard:
        return [(status.fault if status and status.fault else "Waiting for the server …", "TIME")]
    lines = []
    if not status.connected:
        lines.append(("The device is not connected; retrying …", "UNLINKED"))
    elif status.emitting:
        latency = f", latency {status.latency * 1e3:.0f} ms" if status.latency is not None else ""
        points = "1 focal point" if status.foci == 1 else f"{status.foci} focal points"
        lines.append(
            (f"{points}, {status.frames_per_second} frames/s{latency}", "OUTLINER_OB_SPEAKER")
        )
    else:
        lines.append(("Connected and silent.", "LINKED"))
    if status.emitting and not status.connected:
        lines.append(("The array may still be emitting. Switch off its power.", "ERROR"))
    if status.dropped:
        lines.append((f"{status.dropped} frames replaced by newer ones", "NONE"))
    if status.outside:
        lines.append((f"{status.outside} focal points outside the working volume", "NONE"))
    if status.fault:
        lines.append((status.fault, "ERROR"))
    return lines


class CLAY_PT_touch(bpy.types.Panel):  # noqa: N801
    """Touch of the clay through an ultrasound array."""

    bl_label = "Touch"
    bl_order = 5
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Clay"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.use_property_decorate = False
        properties = context.scene.tactile_touch
        if properties.array is None:
            layout.operator_menu_enum("clay.array_add", "preset", text="Add Array", icon="ADD")
        else:
            layout.prop(properties, "array")
        column = layout.column()
        column.enabled = touch.client is None
        column.prop(properties, "kind")
        for name in _DEVICE_PROPERTIES.get(properties.kind, ()):
            column.prop(properties, name)
        missing = missing_touch_package(properties.kind)
        if missing:
            draw_text(layout.box(), missing, icon="ERROR")
        elif touch.client is None:
            layout.operator("clay.touch_connect", icon="PLAY")
        else:
            layout.operator("clay.touch_disconnect", icon="CANCEL")
        for text, icon in status_lines():
            draw_text(layout, text, icon=icon)
        column = layout.column()
        column.prop(properties, "gain")
        column.prop(properties, "ceiling")
        column.prop(properties, "focus_count")
        column.prop(properties, "use_weights")
        column.prop(properties, "modulation")
        column.prop(properties, "play_baked")
        column.prop(properties, "show_overlay")
        layout.operator("clay.touch_sensitivity", icon="COLOR")
        layout.operator("clay.touch_picture", icon="IMAGE_DATA")


def register() -> None:
    """Register the panel."""
    bpy.utils.register_class(CLAY_PT_touch)


def unregister() -> None:
    """Unregister the panel."""
    bpy.utils.unregister_class(CLAY_PT_touch)
