# SPDX-License-Identifier: GPL-3.0-or-later
"""The built zip goes into a clean profile of a real Blender and out of it again."""

from pathlib import Path
from typing import Any

MODULE = "bl_ext.user_default.tactile_clay"
SWITCH = f"""
import sys
import bpy

def state():
    return ({MODULE!r} in bpy.context.preferences.addons, "warp" in sys.modules)

print("STATE at start", state())
for word, operator in [
    ("disabled", bpy.ops.preferences.addon_disable),
    ("enabled", bpy.ops.preferences.addon_enable),
    ("disabled", bpy.ops.preferences.addon_disable),
]:
    assert operator(module={MODULE!r}) == {{"FINISHED"}}, word
    print("STATE", word, state())
"""
IMPORT_WHEELS = """
import sys
import pysplashsurf, trimesh, warp, websockets

for module in (pysplashsurf, trimesh, warp, websockets):
    print("WHEEL", module.__name__, module.__file__)
"""


def test_extension_installs_switches_and_uninstalls(blender: Any, extension_zip: Path) -> None:
    """Install, disable, enable and remove the extension without an error or a trace."""
    installed = blender.install(extension_zip)
    assert installed.exit_code == 0, installed.output
    assert "Traceback" not in installed.output
    assert "Error" not in installed.output

    switched = blender.run_script(SWITCH)
    assert switched.exit_code == 0, switched.output
    assert "Traceback" not in switched.output
    states = [line for line in switched.output.splitlines() if line.startswith("STATE")]
    assert states == [
        "STATE at start (True, False)",
        "STATE disabled (False, False)",
        "STATE enabled (True, False)",
        "STATE disabled (False, False)",
    ]

    removed = blender.uninstall()
    assert removed.exit_code == 0, removed.output
    left = [path for path in blender.profile.rglob("*") if "tactile_clay" in path.name]
    assert left == []


def test_wheels_are_the_bundled_ones(blender_with_extension: Any) -> None:
    """Import Warp and the other libraries from the profile that the zip was installed into."""
    result = blender_with_extension.run_script(IMPORT_WHEELS)
    assert result.exit_code == 0, result.output
    found = [line.split() for line in result.output.splitlines() if line.startswith("WHEEL")]
    profile = blender_with_extension.path_inside(blender_with_extension.profile)
    assert [name for _, name, _ in found] == ["pysplashsurf", "trimesh", "warp", "websockets"]
    assert all(file.startswith(profile) for _, _, file in found), found
