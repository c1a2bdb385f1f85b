# SPDX-License-Identifier: GPL-3.0-or-later
"""The brush in the 3D view's tool header, and a menu of all tools."""

from __future__ import annotations

from typing import Any

import bpy

from ..core.tools.tools import BY_IDENTIFIER, TOOLS, tool_items
from .live.current import current
from .properties import stamp_fault


class CLAY_OT_sculpt_tool(bpy.types.Operator):  # noqa: N801
    """Choose a tool"""

    bl_idname = "clay.sculpt_tool"
    bl_label = "Choose Tool"
    # Choosing a tool is not an undo step.
    bl_options = {"INTERNAL"}

    tool: bpy.props.EnumProperty(name="Tool", items=tool_items())

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        """The tool's description, as tooltip."""
        return BY_IDENTIFIER[properties.tool].description

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Set the tool."""
        context.scene.tactile_clay_sculpt.tool = self.tool
        return {"FINISHED"}


class CLAY_MT_sculpt_tools(bpy.types.Menu):  # noqa: N801
    """All tools (Shift Space)."""

    bl_label = "Clay Tools"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the menu."""
        layout = self.layout
        for tool in TOOLS:
            if tool.identifier in ("FINGER", "KNIFE", "SMOOTH", "ADD"):
                layout.separator()
            entry = layout.operator("clay.sculpt_tool", text=tool.label, icon=tool.icon)
            entry.tool = tool.identifier


def draw_brush(layout: Any, properties: Any, *, compact: bool) -> None:
    """Draw the brush's tool and the settings that it uses.

    Args:
        layout: The layout to draw in.
        properties: ``Scene.tactile_clay_sculpt``.
        compact: Whether to draw on one line, for a header.
    """
    tool = BY_IDENTIFIER[properties.tool]
    unnamed = {"text": ""} if compact else {}
    row = layout.row(align=True)
    row.label(icon=tool.icon)
    row.menu("CLAY_MT_sculpt_tools", text=tool.label)
    if not compact:
        layout.use_property_split = True
        layout.use_property_decorate = False
    if tool.identifier == "NONE":
        return
    if tool.identifier == "STAMP":
        layout.prop(properties, "stamp", **unnamed)
        fault = stamp_fault(properties.stamp)
        if fault:
            layout.label(text=fault if not compact else "Not closed", icon="ERROR")
    layout.prop(properties, "radius")
    row = layout.row(align=True)
    if tool.path != "view":
        row.prop(properties, "strength")
        row.prop(properties, "use_pressure", text="", icon="STYLUS_PRESSURE")
    if tool.edit in ("add", "paint"):
        layout.prop(properties, "color", **unnamed)
    row = layout.row(align=True, heading="" if compact else "Mirror")
    if compact:
        row.label(icon="MOD_MIRROR")
    for name in ("mirror_x", "mirror_y", "mirror_z"):
        row.prop(properties, name, toggle=True)


def _draw_in_header(self: Any, context: bpy.types.Context) -> None:
    if current.session is None:
        return
    layout = self.layout
    layout.separator()
    draw_brush(layout, context.scene.tactile_clay_sculpt, compact=True)
    layout.operator("clay.sculpt_finish", icon="CHECKMARK")


_CLASSES = (CLAY_OT_sculpt_tool, CLAY_MT_sculpt_tools)


def register() -> None:
    """Register the classes and extend the tool header."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.VIEW3D_HT_tool_header.append(_draw_in_header)


def unregister() -> None:
    """Unregister the classes and restore the tool header."""
    bpy.types.VIEW3D_HT_tool_header.remove(_draw_in_header)
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
