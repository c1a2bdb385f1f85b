# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes made without the add-on: colliders animated in various ways by stock Blender."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.base.mesh_geometry import evaluated_mesh, transform
from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.core.storage.cache import Cache

BUILD = """
import os, sys
import bpy
path, scale, system = sys.argv[-3], float(sys.argv[-2]), sys.argv[-1]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.unit_settings.scale_length, scene.unit_settings.system = scale, system
u = 1 / scale
scene.gravity = (0, 0, -9.81 * u)
scene.frame_start, scene.frame_end = 1, 13

def box(name, x, y, z, sx, sy, sz):
    "Add a box by its center and side lengths [m]."
    corners = [(a * sx * u, b * sy * u, c * sz * u)
               for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (-0.5, 0.5)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], faces)
    item = bpy.data.objects.new(name, mesh)
    item.location = (x * u, y * u, z * u)
    scene.collection.objects.link(item)
    return item

def key(item, path, first, last):
    for frame, value in ((1, first), (13, last)):
        if isinstance(value, tuple):
            setattr(item, path, value)
        else:
            item[path] = value
        item.keyframe_insert(path, frame=frame)

for number in range(4):
    box(f"Block {number}", 0.2 * number, 0.02, 0.025, 0.04, 0.04, 0.04)
box("Table", 0.3, 0.0, -0.01, 1.0, 0.4, 0.02).scale = (1.0, 1.0, 1.0)

# Parented to an empty that is keyed, rotated and scaled unevenly.
empty = bpy.data.objects.new("Handle", None)
scene.collection.objects.link(empty)
empty.scale, empty.rotation_euler = (2.0, 1.0, 0.5), (0, 0, 3.14159265)
moved = box("Moved", 0, 0, 0, 0.03, 0.02, 0.12)
moved.parent = empty
key(empty, "location", (0, -0.011 * u, 0.03 * u), (0, 0.009 * u, 0.03 * u))

# Deformed by a bone that is keyed.
bent = box("Boned", 0.2, -0.011, 0.03, 0.06, 0.02, 0.06)
armature = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
scene.collection.objects.link(armature)
bpy.context.view_layer.objects.active = armature
bpy.ops.object.mode_set(mode="EDIT")
bone = armature.data.edit_bones.new("Push")
bone.head, bone.tail = (0.2 * u, 0, 0), (0.2 * u, 0.1 * u, 0)
bpy.ops.object.mode_set(mode="OBJECT")
bent.vertex_groups.new(name="Push").add(list(range(8)), 1.0, "REPLACE")
bent.modifiers.new("Armature", "ARMATURE").object = armature
pose = armature.pose.bones["Push"]
key(pose, "location", (0.0, 0.0, 0.0), (0.0, 0.02 * u, 0.0))

# Extended by a shape key.
shaped = box("Shaped", 0.4, -0.011, 0.03, 0.06, 0.02, 0.06)
shaped.shape_key_add(name="Basis")
reach = shaped.shape_key_add(name="Reach")
for vertex, point in zip(shaped.data.vertices, reach.data):
    if vertex.co.y > 0:
        point.co.y += 0.02 * u
for frame, value in ((1, 0.0), (13, 1.0)):
    reach.value = value
    reach.keyframe_insert("value", frame=frame)

# Grown by its scale, which is uneven and keyed.
grown = box("Grown", 0.6, -0.011, 0.03, 0.03, 0.01, 0.12)
key(grown, "scale", (2.0, 2.0, 0.5), (2.0, 6.0, 0.5))

bpy.ops.wm.save_as_mainfile(filepath=path)
assert not [name for name in sys.modules if name.startswith("tactile_clay")]
sys.stdout.flush()
os._exit(0)
"""


def baked(folder: Path, scale: float, system: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """Open a scene built by stock Blender, make clay in it, and bake.

    Returns:
        The scene, and the particles at its first and last frame [m], shape [4, N, 3].
    """
    folder.mkdir()
    path = folder / "foreign.blend"
    (folder / "build.py").write_text(BUILD)
    command = [sys.executable, str(folder / "build.py"), str(path), str(scale), system]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert path.is_file(), done.stdout[-2000:] + done.stderr[-2000:]
    bpy.ops.wm.open_mainfile(filepath=str(path))
    scene = bpy.context.scene
    for number in range(4):
        block = scene.objects[f"Block {number}"]
        make_clay(bpy.context, [block], spacing=0.01 / scale, name=f"Clay {number}")
    for name in ("Table", "Moved", "Boned", "Shaped", "Grown"):
        scene.objects[name].tactile_clay.role = "COLLIDER"
    result = bake(bpy.context)
    assert (result.quarantined, result.warnings) == (0, ())
    assert result.max_penetration is not None and result.max_penetration < 0.001
    cache = Cache(result.directory)
    first, last = (cache.read_frame(n).positions.reshape(4, -1, 3) * scale for n in (1, 13))
    return scene, first, last


@pytest.mark.parametrize(
    ("scale", "system"), [(1.0, "METRIC"), (0.001, "METRIC"), (0.3048, "IMPERIAL")]
)
def test_every_kind_of_animated_collider_pushes_its_clay(
    studio: Any, tmp_path: Path, scale: float, system: str
) -> None:
    """Colliders moved by parents, armatures, shape keys or scale push the clay, in any unit."""
    scene, first, last = baked(tmp_path / "scene", scale, system)
    scene.frame_set(13)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for number, name in enumerate(("Moved", "Boned", "Shaped", "Grown")):
        tool = scene.objects[name]
        vertices, _ = evaluated_mesh(tool, depsgraph)
        front = transform(tool.evaluated_get(depsgraph).matrix_world, vertices)[:, 1].max() * scale
        assert front == pytest.approx(0.019, abs=1e-4), name
        # The face moved 20 mm; the clay was in its way for most of them.
        assert first[number][:, 1].min() == pytest.approx(0.005, abs=1e-4)
        assert last[number][:, 1].min() > front, name
        assert (last[number] - first[number])[:, 1].max() > 0.01, name
        # The clay still lies on the table, and did not move sideways.
        assert abs((last[number] - first[number])[:, 0].mean()) < 0.001
        assert last[number][:, 2].min() > 0.002
