# SPDX-License-Identifier: GPL-3.0-or-later
"""Packed playback: frames stored in the .blend play without the add-on."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.clay import look
from tactile_clay.clay_addon.deliver.export import export_clay
from tactile_clay.clay_addon.model.point_cloud import make_point_cloud
from tactile_clay.clay_addon.playback.pack import PackError, pack, unpack
from tactile_clay.clay_addon.playback.packed import MODIFIER_NAME, is_packed, packed_positions

COUNT = 50


@pytest.fixture
def clay() -> Any:
    """Clay that shows points, in an empty file, without the add-on registered."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rng = np.random.default_rng(0)
    item = make_point_cloud(
        bpy.context,
        rng.uniform(0, 0.02, (COUNT, 3)).astype(np.float32),
        rng.uniform(0, 1, (COUNT, 4)).astype(np.float32),
        0.005,
        "Clay",
    )
    look.set_input(look.add_look(item), "Surface", False)
    return item


def some_frames(first: int, last: int) -> dict[int, np.ndarray]:
    """Random positions for every frame."""
    rng = np.random.default_rng(last)
    return {
        number: rng.normal(0, 0.1, (COUNT, 3)).astype(np.float32)
        for number in range(first, last + 1)
    }


def shown(item: Any) -> np.ndarray:
    """Positions of the evaluated points."""
    geometry = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    positions = np.empty((len(geometry.pointcloud.points), 3), np.float32)
    geometry.pointcloud.attributes["position"].data.foreach_get("vector", positions.ravel())
    return positions


def test_every_frame_is_exact_and_the_ends_are_held(clay: Any) -> None:
    """Show every frame bit for bit, even negative ones, and hold the ends beyond the range."""
    frames = some_frames(-2, 12)
    pack(clay, frames)
    assert is_packed(clay)
    for number in [*frames, -100, 500]:
        bpy.context.scene.frame_set(number)
        expected = frames[min(max(number, -2), 12)]
        np.testing.assert_array_equal(shown(clay), expected)
        np.testing.assert_array_equal(packed_positions(clay, number), expected)


def test_subframes_are_interpolated(clay: Any) -> None:
    """Interpolate linearly between two frames."""
    frames = some_frames(1, 3)
    pack(clay, frames)
    bpy.context.scene.frame_set(2, subframe=0.25)
    expected = 0.75 * frames[2] + 0.25 * frames[3]
    np.testing.assert_allclose(shown(clay), expected, atol=1e-7)
    np.testing.assert_allclose(packed_positions(clay, 2.25), expected, atol=1e-7)


def test_playback_comes_before_the_look(clay: Any) -> None:
    """Make the surface from the packed positions, not from the rest positions."""
    assert [item.name for item in clay.modifiers] == ["Clay Surface"]
    pack(clay, {1: np.tile([5.0, 0.0, 0.0], (COUNT, 1))})
    assert [item.name for item in clay.modifiers] == [MODIFIER_NAME, "Clay Surface"]
    look.set_input(clay.modifiers["Clay Surface"], "Surface", True)
    geometry = clay.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    assert geometry.mesh.vertices[0].co.x == pytest.approx(5, abs=0.01)


def test_packing_again_replaces_and_unpacking_restores(clay: Any) -> None:
    """Leave no frame of an earlier pack, and restore the object on unpacking."""
    before = {item.name for item in clay.data.attributes}
    rest = shown(clay)
    pack(clay, some_frames(1, 20))
    frames = some_frames(5, 7)
    pack(clay, frames)
    assert len(clay.data.attributes) == len(before) + 3
    bpy.context.scene.frame_set(20)
    np.testing.assert_array_equal(shown(clay), frames[7])
    assert unpack(clay)
    assert not is_packed(clay)
    assert {item.name for item in clay.data.attributes} == before
    assert [item.name for item in clay.modifiers] == ["Clay Surface"]
    np.testing.assert_array_equal(shown(clay), rest)
    assert not unpack(clay)


def test_two_clays_share_one_node_group(clay: Any) -> None:
    """Play each object's own frames with one shared node group."""
    other = clay.copy()
    other.data = clay.data.copy()
    bpy.context.collection.objects.link(other)
    pack(clay, {1: np.zeros((COUNT, 3))})
    pack(other, {1: np.ones((COUNT, 3))})
    assert shown(clay).max() == 0
    assert shown(other).min() == 1
    assert len([tree for tree in bpy.data.node_groups if "Playback" in tree.name]) == 1


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ({}, "no frames"),
        ({1: np.zeros((COUNT, 3)), 4: np.zeros((COUNT, 3))}, "2 frames are missing.* 2"),
        ({1: np.zeros((COUNT - 1, 3))}, r"shape \(49, 3\)"),
        ({1: np.full((COUNT, 3), np.nan)}, "not finite"),
        ({2**25: np.zeros((COUNT, 3))}, "beyond"),
    ],
)
def test_bad_frames_change_nothing(clay: Any, frames: dict[int, np.ndarray], message: str) -> None:
    """Refuse frames that cannot be packed, and keep playing those packed before."""
    good = some_frames(1, 2)
    pack(clay, good)
    with pytest.raises(PackError, match=message):
        pack(clay, frames)
    bpy.context.scene.frame_set(1)
    np.testing.assert_array_equal(shown(clay), good[1])


def test_other_objects_are_refused(clay: Any) -> None:
    """Refuse to pack a mesh."""
    mesh = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    assert not is_packed(mesh)
    with pytest.raises(PackError, match="'Cube' is a mesh"):
        pack(mesh, some_frames(1, 1))


READ_BACK = """
import json, os, sys
import bpy, numpy as np
folder = sys.argv[-1]
bpy.ops.wm.open_mainfile(filepath=folder + "/packed.blend")
result = {"foreign": [name for name in sys.modules if name.startswith("tactile_clay")]}
clay = bpy.data.objects["Clay"]
frames = np.load(folder + "/frames.npz")
wrong = []
for name in frames.files:
    bpy.context.scene.frame_set(int(name))
    geometry = clay.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    found = np.empty(frames[name].shape, np.float32)
    geometry.pointcloud.attributes["position"].data.foreach_get("vector", found.ravel())
    if not np.array_equal(found, frames[name]):
        wrong.append(name)
result["frames"] = len(frames.files)
result["wrong"] = wrong
scene = bpy.context.scene
scene.frame_start, scene.frame_end = 1, 3
scene.render.filepath = folder + "/render_"
bpy.ops.render.render(animation=True)
centers = []
for number in (1, 2, 3):
    image = bpy.data.images.load(folder + f"/render_{number:04d}.png")
    alpha = np.array(image.pixels[:], np.float32).reshape(8, 24, 4)[..., 3].sum(axis=0)
    centers.append(float((alpha * np.arange(24)).sum() / alpha.sum()))
result["centers"] = centers
with open(folder + "/result.json", "w") as file:
    json.dump(result, file)
sys.stdout.flush()
os._exit(0)
"""


def test_saved_file_plays_and_renders_without_the_addon(clay: Any, tmp_path: Path) -> None:
    """Show exact frames and render motion in a new process that never loads the add-on."""
    frames = some_frames(1, 8)
    for number, x in ((1, -0.08), (2, 0.0), (3, 0.08)):
        frames[number] = (frames[number] * 0.05 + [x, 0, 0]).astype(np.float32)
    pack(clay, frames)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location = (0, 0, 1)
    camera.data.type, camera.data.ortho_scale = "ORTHO", 0.24
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = 24, 8
    scene.render.image_settings.color_mode = "RGBA"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "packed.blend"))
    stored: dict[str, Any] = {str(number): part for number, part in frames.items()}
    np.savez(tmp_path / "frames.npz", **stored)
    (tmp_path / "read_back.py").write_text(READ_BACK)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "read_back.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (tmp_path / "result.json").exists(), done.stdout[-2000:] + done.stderr[-2000:]
    result = json.loads((tmp_path / "result.json").read_text())
    assert result["foreign"] == []
    assert result["frames"] == 8
    assert result["wrong"] == []
    assert result["centers"] == pytest.approx([3.5, 11.5, 19.5], abs=1)


# The operators ------------------------------------------------------------------------------


def baked(studio: Any, folder: Path) -> tuple[Any, dict[int, np.ndarray]]:
    """A baked falling block, and its frames in world space."""
    from tactile_clay.clay_addon.bake.bake import bake

    item = studio.falling_block(folder)
    bake(bpy.context)
    frames = {}
    for number in range(1, 7):
        studio.scene.frame_set(number)
        frames[number] = studio.points(item)
    return item, frames


def world(item: Any, positions: np.ndarray) -> np.ndarray:
    """Local positions in world space."""
    matrix = np.array(item.matrix_world)
    return positions @ matrix[:3, :3].T + matrix[:3, 3]


def test_packed_bake_plays_when_the_cache_is_gone(studio: Any, tmp_path: Path) -> None:
    """Show and export the packed frames without the cache."""
    item, frames = baked(studio, tmp_path)
    assert bpy.ops.clay.pack() == {"FINISHED"}
    shutil.rmtree(tmp_path / "clay_cache")
    look.set_input(item.modifiers["Clay Surface"], "Surface", False)
    for number, expected in frames.items():
        studio.scene.frame_set(number)
        np.testing.assert_allclose(world(item, shown(item)), expected, atol=1e-6)
    studio.scene.frame_set(6)
    export_clay(bpy.context, tmp_path / "clay.stl")
    corners = np.frombuffer((tmp_path / "clay.stl").read_bytes()[84:], np.uint8).reshape(-1, 50)
    z = corners[:, 12:48].copy().view(np.float32).reshape(-1, 3)[:, 2]
    assert z.min() == pytest.approx(frames[6][:, 2].min() - 0.005, abs=0.0025)
    assert bpy.ops.clay.unpack() == {"FINISHED"}
    assert not is_packed(item)
    assert not bpy.ops.clay.unpack.poll()


def test_incomplete_or_foreign_bake_is_not_packed(studio: Any, tmp_path: Path) -> None:
    """Refuse a bake that is missing, incomplete or of different clay, and say what to do."""
    assert not bpy.ops.clay.pack.poll()
    item = studio.falling_block(tmp_path)
    assert "Bake first" in studio.refused(bpy.ops.clay.pack)
    from tactile_clay.clay_addon.bake.bake import bake

    bake(bpy.context)
    item.name = "Renamed"
    item.location.x += 1.0
    bpy.context.view_layer.update()
    assert "Bake again" in studio.refused(bpy.ops.clay.pack)
    item.location.x -= 1.0
    bpy.context.view_layer.update()
    (tmp_path / "clay_cache" / "frame_000003.npz").unlink()
    assert "Resume" in studio.refused(bpy.ops.clay.pack)
    assert not is_packed(item)


def test_linked_clay_is_not_packed(studio: Any, tmp_path: Path) -> None:
    """Refuse to store frames in data that is not saved with this file."""
    item = studio.falling_block(tmp_path)
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {item})
    bpy.data.objects.remove(item)
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, into):
        into.objects = ["Clay"]
    (item,) = into.objects
    with pytest.raises(PackError, match="'Clay' is linked from another file"):
        pack(item, {1: np.zeros((64, 3))})
    assert not item.modifiers.get("Clay Playback")


def test_packing_can_be_undone(studio: Any, tmp_path: Path) -> None:
    """Remove the packed frames on undo, and restore them on redo."""
    item, _ = baked(studio, tmp_path)
    bpy.ops.ed.undo_push(message="baked")
    bpy.ops.clay.pack()
    bpy.ops.ed.undo_push(message="packed")
    assert is_packed(bpy.data.objects[item.name])
    bpy.ops.ed.undo()
    assert not is_packed(bpy.data.objects["Clay"])
    bpy.ops.ed.redo()
    assert is_packed(bpy.data.objects["Clay"])
