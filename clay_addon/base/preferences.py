# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences, and notices about missing parts of the installation."""

import importlib.util
import tomllib
from pathlib import Path

import bpy

ADDON = (__package__ or "").removesuffix(".clay_addon.base")
"""The add-on's module name in Blender."""

ADDON_VERSION: str = tomllib.loads(
    (Path(__file__).parents[2] / "blender_manifest.toml").read_text(encoding="utf-8")
)["version"]
"""The version in the manifest."""


def missing_parts() -> list[str]:
    """A message for each missing part of the installation, saying what to do; usually empty."""
    missing = []
    try:
        found = importlib.util.find_spec("warp") is not None
    except ImportError:
        found = False
    if not found:
        missing.append(
            "NVIDIA Warp is missing: clay cannot be made or baked. Install the extension from its "
            "zip for this platform, which includes Warp, or add the package warp-lang to this "
            "Python, then restart Blender."
        )
    return missing


class ClayPreferences(bpy.types.AddonPreferences):
    """Preferences of the add-on."""

    bl_idname = ADDON

    device: bpy.props.EnumProperty(
        name="Device",
        description="Where the clay is simulated",
        items=(
            ("auto", "Automatic", "The first CUDA graphics card if there is one, else the CPU"),
            ("cpu", "CPU", "The processor; works on every computer"),
            ("cuda:0", "CUDA", "The first NVIDIA graphics card"),
        ),
        default="auto",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the preferences."""
        draw_missing_parts(self.layout)
        self.layout.prop(self, "device")
        row = self.layout.row()
        row.alignment = "LEFT"
        row.operator("clay.log_save", icon="TEXT")


def draw_missing_parts(layout: bpy.types.UILayout) -> bool:
    """Draw a notice for each missing part of the installation; returns whether any is missing."""
    missing = missing_parts()
    for sentence in missing:
        box = layout.box()
        draw_text(box, sentence, icon="ERROR")
    return bool(missing)


def draw_text(layout: bpy.types.UILayout, text: str, *, icon: str = "NONE") -> None:
    """Draw a text wrapped to the region's width, as Blender's labels do not wrap."""
    region = bpy.context.region
    pixels = region.width / bpy.context.preferences.system.ui_scale if region else 260
    # A letter is 6.6 pixels wide on average; margins and icon take 70.
    width = max(12, int((pixels - 70) / 6.6))
    column = layout.column(align=True)
    line = ""
    for word in [*text.split(), ""]:
        if line and (not word or len(line) + 1 + len(word) > width):
            column.label(text=line, icon=icon)
            icon = "BLANK1" if icon != "NONE" else "NONE"
            line = word
        else:
            line = f"{line} {word}".strip()


def device_choice(context: bpy.types.Context) -> str:
    """The device chosen in the preferences: ``auto``, ``cpu`` or ``cuda:0``."""
    addon = context.preferences.addons.get(ADDON)
    return addon.preferences.device if addon and addon.preferences else "auto"


def register() -> None:
    """Register the preferences."""
    bpy.utils.register_class(ClayPreferences)


def unregister() -> None:
    """Unregister the preferences."""
    bpy.utils.unregister_class(ClayPreferences)
