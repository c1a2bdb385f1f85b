# SPDX-License-Identifier: GPL-3.0-or-later
"""A real Blender bakes and renders a shot as tasks of the Open Job Description template."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

MAKE_SHOT = """
import sys
import bpy

path = sys.argv[sys.argv.index("--") + 1]
bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
bpy.ops.mesh.primitive_cube_add(size=0.04, location=(0.0, 0.0, 0.03))
assert bpy.ops.clay.make(spacing=0.01) == {"FINISHED"}
bpy.ops.mesh.primitive_plane_add(size=1.0)
assert bpy.ops.clay.collider_add() == {"FINISHED"}
bpy.ops.object.light_add(type="SUN", rotation=(0.5, 0.3, 0.0))
bpy.ops.object.camera_add(location=(0.2, -0.2, 0.15), rotation=(1.1, 0.0, 0.785))
scene = bpy.context.scene
scene.camera = bpy.context.object
scene.frame_end = 4
scene.render.engine = "CYCLES"
scene.cycles.samples = 4
scene.render.resolution_x, scene.render.resolution_y = 96, 64
bpy.ops.wm.save_as_mainfile(filepath=path)
"""


def test_template_bakes_and_renders(blender_with_extension: Any, repository: Path) -> None:
    """Bake, then render two chunks, on a machine that has the files elsewhere than we."""
    blender = blender_with_extension
    scene = blender.folder / "shot.blend"
    made = blender.run_script(MAKE_SHOT, scene)
    assert made.exit_code == 0, made.output
    rule = {
        "source_path_format": "POSIX",
        "source_path": "/projects",
        "destination_path": blender.path_inside(blender.folder),
    }
    parameters = {
        "SceneFile": "/projects/shot.blend",
        "OutputFolder": "/projects/shot",
        "Frames": "1-4",
        "ChunkSize": 2,
        "Blender": blender.command[0],
    }
    rules = {"version": "pathmapping-1.0", "path_mapping_rules": [rule]}
    environment = os.environ | {"BLENDER_USER_RESOURCES": blender.path_inside(blender.profile)}
    result = subprocess.run(
        [
            *(sys.executable, "-m", "openjd", "run"),
            str(repository / "presets/farm/clay_bake_render.openjd.yaml"),
            *("--step", "Render", "--run-dependencies"),
            *("--job-param", json.dumps(parameters)),
            *("--path-mapping-rules", json.dumps(rules)),
        ],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert "Frames 1 to 4: 4 baked, 0 kept" in result.stdout
    assert result.stdout.count("2 frames rendered, 0 kept") == 2
    pictures = sorted((blender.folder / "shot" / "frames").iterdir())
    assert [path.name for path in pictures] == [f"frame_{number:04}.png" for number in range(1, 5)]
    assert pictures[0].read_bytes() != pictures[3].read_bytes()
