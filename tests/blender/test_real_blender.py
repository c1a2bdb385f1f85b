# SPDX-License-Identifier: GPL-3.0-or-later
"""The main job in a real Blender with the installed zip, from a mesh to an exported shape."""

import json
from pathlib import Path
from typing import Any

import pytest
import trimesh

MAKE = """
import sys
import bpy

assert "warp" not in sys.modules
path = sys.argv[sys.argv.index("--") + 1]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.preferences.addon_enable(module="bl_ext.user_default.tactile_clay")
bpy.ops.mesh.primitive_cube_add(size=0.04, location=(0.0, 0.0, 0.03))
assert bpy.ops.clay.make(spacing=0.01) == {"FINISHED"}
bpy.ops.mesh.primitive_plane_add(size=1.0)
assert bpy.ops.clay.collider_add() == {"FINISHED"}
bpy.context.scene.frame_end = 6
bpy.ops.wm.save_as_mainfile(filepath=path)
"""
PLAY = """
import sys
import bpy
import numpy as np

scene = bpy.context.scene
clay = scene.objects["Clay"]

def lowest():
    values = np.empty(3 * len(clay.data.points), np.float32)
    clay.data.attributes["position"].data.foreach_get("vector", values)
    return float(values.reshape(-1, 3)[:, 2].min() + clay.location.z)

for frame in (1, 6):
    scene.frame_set(frame)
    print("LOWEST", frame, round(lowest(), 4))
module = "bl_ext.user_default.tactile_clay"
bpy.ops.preferences.addon_disable(module=module)
left = [name for name in dir(bpy.types) if name.startswith("CLAY_")]
print("LEFT", left, hasattr(bpy.types.Object, "tactile_clay"))
bpy.ops.preferences.addon_enable(module=module)
"""
PANEL = """
import bpy

from bl_ext.user_default.tactile_clay.clay_addon import panel
from bl_ext.user_default.tactile_clay.clay_addon.base.activity import clay_activity
from bl_ext.user_default.tactile_clay.clay_addon.playback.playback import cache_of

drawn = []

def recorded(cls):
    draw = cls.draw

    def draw_and_record(self, context):
        draw(self, context)
        drawn.append(cls.bl_label)

    cls.draw = draw_and_record

def view():
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window, area=area, region=region)

def draw_panels():
    with view():
        for cls in panel._CLASSES:
            recorded(cls)
            bpy.ops.wm.call_panel(name=cls.__name__)
            bpy.ops.wm.redraw_timer(type="DRAW_WIN_SWAP", iterations=1)
        print("DRAWN", sorted(set(drawn)))
        print("BAKE", bpy.ops.clay.bake("INVOKE_DEFAULT"))
    bpy.app.timers.register(wait, first_interval=0.2)

def wait():
    if clay_activity.kind is not None:
        return 0.2
    print("FRAMES", cache_of(bpy.context.scene).frames(), flush=True)
    bpy.ops.wm.quit_blender()

bpy.app.timers.register(draw_panels, first_interval=0.5)
"""


@pytest.fixture
def scene_file(blender_with_extension: Any) -> Path:
    """A .blend with a block of clay over a table, made in the real Blender."""
    path = Path(blender_with_extension.folder / "scene.blend")
    result = blender_with_extension.run_script(MAKE, path)
    assert result.exit_code == 0, result.output
    return path


def command(blender: Any, path: Path, *words: str | Path) -> Any:
    """Run ``blender -b FILE -c clay WORDS``."""
    return blender.run("-b", path, "-c", "clay", *words)


def test_clay_is_made_baked_played_and_exported(
    blender_with_extension: Any, scene_file: Path
) -> None:
    """Do the whole job with the installed extension, and unregister without a trace."""
    blender = blender_with_extension
    baked = command(blender, scene_file, "bake")
    assert baked.exit_code == 0, baked.output
    assert "Frames 1 to 6: 6 baked, 0 kept" in baked.output
    assert len(list((blender.folder / "clay_cache").glob("frame_*.npz"))) == 6

    told = command(blender, scene_file, "info", "--json")
    assert told.exit_code == 0, told.output
    table = json.loads(told.output[told.output.index("\n{") : told.output.rindex("}") + 1])
    assert table["bake"]["frames"] == 6
    assert table["clay"][0]["particle_count"] == 64

    shape = blender.folder / "shape.stl"
    exported = command(blender, scene_file, "export", "--frame", "6", "--output", shape)
    assert exported.exit_code == 0, exported.output
    mesh = trimesh.load(shape)
    assert isinstance(mesh, trimesh.Trimesh)
    assert mesh.is_watertight
    # STL is in millimeters, as printers read it.
    assert mesh.volume == pytest.approx(64e3, rel=0.01)

    played = blender.run_script(PLAY, scene=scene_file)
    assert played.exit_code == 0, played.output
    assert "Traceback" not in played.output
    assert "LOWEST 1 0.015" in played.output
    assert "LOWEST 6 0.00" in played.output
    assert "LEFT [] False" in played.output


def test_exit_codes_reach_the_shell(blender_with_extension: Any, scene_file: Path) -> None:
    """Return usage and stale errors of the command as Blender's exit code."""
    blender = blender_with_extension
    assert command(blender, scene_file, "bake", "--frames", "9").exit_code == 2
    assert command(blender, scene_file, "bake", "--frames", "1-2").exit_code == 0
    moved = blender.run_script(
        "import bpy\nbpy.context.scene.gravity.z = -1\nbpy.ops.wm.save_mainfile()",
        scene=scene_file,
    )
    assert moved.exit_code == 0, moved.output
    stale = command(blender, scene_file, "bake", "--resume")
    assert stale.exit_code == 3, stale.output
    assert "the scene has changed: gravity" in stale.output


def test_panel_draws_and_bakes_in_a_window(blender_with_extension: Any, scene_file: Path) -> None:
    """Draw the Clay tab and bake from it, frame by frame, in a window."""
    result = blender_with_extension.run_script(PANEL, scene=scene_file, window=True, timeout=120)
    assert "Traceback" not in result.output, result.output
    assert "DRAWN ['Bake', 'Clay', 'Colliders', 'Export', 'Hands']" in result.output
    assert "BAKE {'RUNNING_MODAL'}" in result.output
    assert "FRAMES [1, 2, 3, 4, 5, 6]" in result.output
