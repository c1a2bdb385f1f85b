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


DEMO = """
import sys
from bl_ext.user_default.tactile_clay.clay_addon.command import demo

output = sys.argv[sys.argv.index("--") + 1]
print("DEMO", demo.main(["--output", output, "--frames", "2", "--width", "32", "--samples", "1"]))
"""
MAKE_CLAY = """
import bpy

bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
bpy.ops.mesh.primitive_cube_add(size=0.04)
assert bpy.ops.clay.make(spacing=0.01) == {"FINISHED"}
bpy.ops.wm.save_userpref()
"""


def files_of(folder: Path) -> set[str]:
    """List the files below a folder."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def test_extension_installs_switches_and_uninstalls(blender: Any, extension_zip: Path) -> None:
    """Install, disable, enable, use and remove the extension without an error or a trace."""
    saved = blender.run_script("import bpy; bpy.ops.wm.save_userpref()")
    assert saved.exit_code == 0, saved.output
    before = files_of(blender.profile)
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

    enabled = f"import bpy; bpy.ops.preferences.addon_enable(module={MODULE!r})"
    used = blender.run_script(enabled + MAKE_CLAY)
    assert used.exit_code == 0, used.output

    assert len(files_of(blender.profile)) > len(before) + 500
    removed = blender.uninstall()
    assert removed.exit_code == 0, removed.output
    left = files_of(blender.profile) - before
    # Blender's own, of every extension that it has ever looked at.
    assert left <= {"extensions/.cache/compat.dat"}
    folders = [path for path in blender.profile.rglob("*") if "tactile_clay" in path.name]
    assert folders == []


def test_wheels_are_the_bundled_ones(blender_with_extension: Any) -> None:
    """Import Warp and the other libraries from the profile that the zip was installed into."""
    result = blender_with_extension.run_script(IMPORT_WHEELS)
    assert result.exit_code == 0, result.output
    found = [line.split() for line in result.output.splitlines() if line.startswith("WHEEL")]
    profile = blender_with_extension.path_inside(blender_with_extension.profile)
    assert [name for _, name, _ in found] == ["pysplashsurf", "trimesh", "warp", "websockets"]
    assert all(file.startswith(profile) for _, _, file in found), found


def test_demo_runs_from_the_zip_alone(blender_with_extension: Any) -> None:
    """Make the demonstration inside Blender, with nothing but what the zip brought."""
    output = blender_with_extension.folder / "demo"
    result = blender_with_extension.run_script(DEMO, output)
    assert "DEMO 0" in result.output, result.output
    assert {path.suffix for path in output.iterdir()} >= {".blend", ".stl", ".ply", ".glb", ".png"}
