# SPDX-License-Identifier: GPL-3.0-or-later
"""Playback: what the viewport and renders show at each frame."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

import tactile_clay
from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.playback import playback


@pytest.fixture
def baked(studio: Any, tmp_path: Path) -> tuple[Any, Cache]:
    """A block of clay that falls on a table, baked from frame 1 to 6."""
    clay = studio.falling_block(tmp_path)
    return clay, Cache(bake(bpy.context).directory)


def test_each_frame_shows_its_bake(studio: Any, baked: tuple[Any, Cache]) -> None:
    """Show the baked positions however the frame is reached."""
    clay, cache = baked
    for frame in (6, 2, 5, 1):
        studio.scene.frame_set(frame)
        expected = cache.read_frame(frame).positions
        np.testing.assert_allclose(studio.points(clay), expected, atol=1e-7)
    assert playback.message(studio.scene) == ""


def test_frames_outside_the_bake_show_its_ends(studio: Any, baked: tuple[Any, Cache]) -> None:
    """Hold the first frame before the range and the last one after it."""
    clay, cache = baked
    for frame, nearest in ((-20, 1), (100, 6)):
        studio.scene.frame_set(frame)
        expected = cache.read_frame(nearest).positions
        np.testing.assert_allclose(studio.points(clay), expected, atol=1e-7)


def test_rest_state_is_shown_before_any_bake(studio: Any, tmp_path: Path) -> None:
    """Leave unbaked clay unchanged."""
    clay = studio.falling_block(tmp_path)
    studio.scene.frame_set(4)
    np.testing.assert_array_equal(studio.points(clay), studio.points(clay, "rest_position"))


@pytest.mark.parametrize("damage", ["missing", "truncated"])
def test_bad_frame_keeps_the_last_good_one(
    studio: Any, baked: tuple[Any, Cache], damage: str
) -> None:
    """Never show an incomplete frame, and report it until a good one is shown."""
    clay, cache = baked
    studio.scene.frame_set(3)
    shown = studio.points(clay)
    path = cache.frame_path(4)
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(path.read_bytes()[:400])
    studio.scene.frame_set(4)
    np.testing.assert_array_equal(studio.points(clay), shown)
    assert playback.message(studio.scene).startswith("Frame 4: ")
    assert ("missing" if damage == "missing" else "damaged") in playback.message(studio.scene)
    studio.scene.frame_set(5)
    assert playback.message(studio.scene) == ""


def test_bake_of_different_clay_is_not_shown(studio: Any, baked: tuple[Any, Cache]) -> None:
    """Show the rest state and say why if the bake has other particles."""
    clay, _ = baked
    clay.name = "Renamed"
    clay.location.x += 1.0
    bpy.context.view_layer.update()
    studio.scene.frame_set(5)
    np.testing.assert_array_equal(studio.points(clay), studio.points(clay, "rest_position"))
    assert "the bake is of different clay: Clay (64 particles)" in playback.message(studio.scene)


def test_renamed_clay_plays_its_bake(studio: Any, baked: tuple[Any, Cache]) -> None:
    """Recognize renamed clay by its starting shape."""
    clay, cache = baked
    clay.name = "Bowl"
    studio.scene.frame_set(5)
    np.testing.assert_allclose(studio.points(clay), cache.read_frame(5).positions, atol=1e-7)
    assert playback.message(studio.scene) == ""


def test_clay_scaled_to_zero_is_reported(studio: Any, baked: tuple[Any, Cache]) -> None:
    """Say why nothing can be shown, instead of failing at every frame."""
    clay, _ = baked
    clay.scale = (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    studio.scene.frame_set(5)
    assert "'Clay' is scaled to zero" in playback.message(studio.scene)
    assert "'Clay' is scaled to zero" in studio.refused(bpy.ops.clay.pack)


def test_unusable_meta_says_what_to_do(studio: Any, baked: tuple[Any, Cache]) -> None:
    """Ask the user to bake again if the cache is from a later version."""
    _, cache = baked
    path = cache.directory / "meta.json"
    path.write_text(path.read_text().replace('"format_version": 1', '"format_version": 2'))
    studio.scene.frame_set(5)
    assert "has format 2; this version of the add-on reads format 1. Bake again." in (
        playback.message(studio.scene)
    )


def test_bake_starts_from_points_moved_before_it(studio: Any, tmp_path: Path) -> None:
    """Keep clay in place when its transform is applied or another piece is joined to it."""
    clay = studio.falling_block(tmp_path, end=2)
    clay.location.x += 0.5
    studio.select(clay)
    bpy.context.view_layer.update()
    before = studio.points(clay)
    assert bpy.ops.object.transform_apply() == {"FINISHED"}
    studio.scene.frame_set(2)
    np.testing.assert_allclose(studio.points(clay), before, atol=1e-6)
    other = studio.clay("Other", location=(0.7, 0.0, 0.03))
    together = np.concatenate([before, studio.points(other)])
    studio.select(clay, other)
    assert bpy.ops.object.join() == {"FINISHED"}
    cache = Cache(bake(bpy.context).directory)
    np.testing.assert_allclose(cache.read_frame(1).positions, together, atol=1e-6)


def test_baked_frame_is_never_mistaken_for_the_rest_state(
    studio: Any, baked: tuple[Any, Cache]
) -> None:
    """Return to the clay's starting shape when the bake is gone, even after Undo."""
    clay, cache = baked
    rest = studio.points(clay, "rest_position")
    bpy.ops.ed.undo_push(message="first frame")
    clay.location.x += 0.1
    bpy.ops.ed.undo_push(message="moved")
    studio.scene.frame_set(6)
    assert not np.array_equal(studio.points(clay), rest)
    cache.free()
    bpy.ops.ed.undo()
    clay = bpy.context.scene.objects["Clay"]
    np.testing.assert_array_equal(studio.points(clay, "rest_position"), rest)
    np.testing.assert_array_equal(studio.points(clay), rest)
    clay.data.attributes["position"].data[3].vector = (float("nan"), 0.0, 0.0)
    bpy.context.scene.frame_set(2)
    np.testing.assert_array_equal(studio.points(clay), rest)


def test_moved_clay_object_plays_back_where_it_was_baked(
    studio: Any, baked: tuple[Any, Cache]
) -> None:
    """Keep world positions even though the object's transform has changed."""
    clay, cache = baked
    clay.location.x += 1.0
    clay.rotation_euler.z = 0.5
    bpy.context.view_layer.update()
    studio.scene.frame_set(5)
    np.testing.assert_allclose(studio.points(clay), cache.read_frame(5).positions, atol=1e-6)


def test_undo_and_redo_show_the_current_frame(studio: Any, baked: tuple[Any, Cache]) -> None:
    """Show the scene's current frame after Undo and Redo."""
    _, cache = baked
    bpy.ops.ed.undo_push(message="frame 1")
    bpy.context.scene.frame_set(6)
    bpy.ops.ed.undo_push(message="frame 6")
    bpy.ops.ed.undo()
    for step in (None, bpy.ops.ed.redo):
        if step:
            step()
        scene = bpy.context.scene
        expected = cache.read_frame(scene.frame_current).positions
        shown = studio.points(scene.objects["Clay"])
        np.testing.assert_allclose(shown, expected, atol=1e-7)


def test_opened_file_shows_its_bake(studio: Any, baked: tuple[Any, Cache], tmp_path: Path) -> None:
    """Show the bake right after opening a file that was moved together with its cache."""
    _, cache = baked
    studio.scene.frame_set(1)
    studio.scene.frame_current = 5
    studio.save(tmp_path)
    expected = cache.read_frame(5).positions
    moved = tmp_path.with_name(tmp_path.name + "-moved")
    tmp_path.rename(moved)
    bpy.ops.wm.open_mainfile(filepath=str(moved / "scene.blend"))
    clay = bpy.context.scene.objects["Clay"]
    np.testing.assert_allclose(studio.points(clay), expected, atol=1e-7)


def test_handlers_are_registered_once(studio: Any) -> None:
    """Leave one handler of each kind after registering again, and none after unregistering."""

    def count() -> list[int]:
        return [
            sum(handler is ours for handler in getattr(bpy.app.handlers, name))
            for name, ours in playback._HANDLERS
        ]

    tactile_clay.register()
    playback.register()
    assert count() == [1, 1, 1, 1]
    tactile_clay.unregister()
    assert count() == [0, 0, 0, 0]
    tactile_clay.register()
    assert count() == [1, 1, 1, 1]


RENDER = """
import os, sys
import bpy, tactile_clay
tactile_clay.register()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
bpy.ops.render.render(animation=True)
sys.stdout.flush()
os._exit(0)
"""


def test_animation_render_shows_each_frame(studio: Any, tmp_path: Path) -> None:
    """Render the baked motion in the background, as ``blender -b FILE -a`` does."""
    studio.clay(location=(0.0, 0.0, 0.0))
    studio.scene.gravity = (20.0, 0.0, 0.0)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = 0.4
    camera.location = (0.0, 0.0, 1.0)
    studio.scene.collection.objects.link(camera)
    studio.scene.camera = camera
    world = bpy.data.worlds.new("World")
    studio.scene.world = world
    render = studio.scene.render
    render.engine = "CYCLES"
    studio.scene.cycles.samples = 1
    studio.scene.cycles.use_denoising = False
    render.film_transparent = True
    render.resolution_x = render.resolution_y = 160
    render.image_settings.color_mode = "RGBA"
    render.filepath = str(tmp_path / "picture_")
    studio.scene.frame_end = 4
    path = studio.save(tmp_path)
    bake(bpy.context)
    result = subprocess.run(
        [sys.executable, "-c", RENDER, str(path)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert result.returncode == 0, result.stderr
    centers = []
    for frame in (1, 2, 3, 4):
        image = bpy.data.images.load(str(tmp_path / f"picture_{frame:04d}.png"))
        opacity = np.array(image.pixels).reshape(160, 160, 4)[:, :, 3]
        centers.append(float((opacity.sum(0) * np.arange(160)).sum() / opacity.sum()))
    # Free fall at 20 m/s² for frames of 1/24 s, seen at 400 pixels per meter.
    np.testing.assert_allclose(np.diff(centers), [6.9, 20.8, 34.7], atol=1.1)
