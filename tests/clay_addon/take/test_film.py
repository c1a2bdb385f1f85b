# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking takes again, with the same or finer clay."""

import json
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from tactile_clay.clay_addon.bake.bake import BakeStaleError, bake
from tactile_clay.clay_addon.command.line import main
from tactile_clay.clay_addon.command.status import scene_status
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.core.surface.exact import reconstruct
from tactile_clay.clay_addon.core.tools.edits import Edit
from tactile_clay.clay_addon.core.tracking.recording.recording import read_recording
from tactile_clay.clay_addon.deliver.export import clay_surface
from tactile_clay.clay_addon.hands.hand import hand_message, hand_objects
from tactile_clay.clay_addon.model.clay_scene import clay_colors, clay_objects, collider_objects
from tactile_clay.clay_addon.panel import cache_state
from tactile_clay.clay_addon.simulate.simulation import Simulation
from tactile_clay.clay_addon.take.film import make_film
from tactile_clay.clay_addon.tracking.armature import CONTACT_PROPERTY
from tactile_clay.clay_addon.tracking.keyframes import import_recording

from .takes import TOP, Loop, record_press, studio_scene

LEAP = Path(__file__).resolve().parents[4] / "shared" / "data" / "leap" / "grab.json.gz"


def baked(film: Any, **options: Any) -> tuple[Any, NDArray[np.float32]]:
    """Bake a film, and return the result and the positions at its last frame."""
    with bpy.context.temp_override(scene=film, view_layer=film.view_layers[0]):
        bpy.context.window.scene = film
        result = bake(bpy.context, **options)
    return result, Cache(result.directory).read_frame(result.end).positions


def printed(capsys: pytest.CaptureFixture[str]) -> Any:
    """The JSON that a command printed, after Blender's own output."""
    text = capsys.readouterr().out
    return json.loads(text[text.index("{") :])


def heights(points: NDArray[np.floating], spacing: float) -> NDArray[np.float64]:
    """Height of the clay's surface over a square around the origin [m], shape [25, 25]."""
    surface = reconstruct(points, spacing)
    tree = BVHTree.FromPolygons(surface.vertices.tolist(), surface.faces.tolist())
    row = np.linspace(-0.014, 0.014, 25)
    hits = [tree.ray_cast(Vector((x, y, 1.0)), Vector((0, 0, -1)))[0] for x in row for y in row]
    return np.array([hit.z for hit in hits]).reshape(25, 25)


def test_live_spacing_gives_the_live_clay(studio: Any, tmp_path: Path) -> None:
    """At the live spacing, with a frame for each step, the film has the live clay."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.6)
    loop.finish()
    film = make_film(bpy.context, spacing=0.005)
    result, last = baked(film)
    assert (result.start, result.end) == (1, 37)
    np.testing.assert_allclose(last, loop.shapes[-1], atol=0.01 * 0.005)


def test_frames_between_steps_give_nearly_the_live_clay(studio: Any, tmp_path: Path) -> None:
    """At 24 frames per second, the film samples the gesture between frames."""
    _, item = studio_scene(studio, tmp_path, rate=24)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.6)
    loop.finish()
    assert studio.scene.tactile_clay.motion_samples == 3
    film = make_film(bpy.context, spacing=0.005)
    _, last = baked(film)
    error = np.linalg.norm(last - loop.shapes[-1], axis=1)
    assert np.sqrt((error**2).mean()) < 0.1 * 0.005
    # A bake with other motion samples cannot be resumed.
    assert bake(bpy.context, resume=True).baked == 0
    film.tactile_clay.motion_samples = 1
    with pytest.raises(BakeStaleError, match="frame rate"):
        bake(bpy.context, resume=True)


def test_half_the_spacing_gives_the_same_dent(studio: Any, tmp_path: Path) -> None:
    """The dent is as deep and large, within the resolution of the live spacing."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.6)
    clay = clay_objects(studio.scene)[0]
    colors = np.where(loop.shapes[0][:, :1] < 0, (1, 0, 0, 1), (0, 0, 1, 1)).astype(np.float32)
    clay.data.attributes["Color"].data.foreach_set("color", colors.ravel())
    loop.finish()
    film = make_film(bpy.context)
    result, last = baked(film)
    assert result.particle_count == pytest.approx(8 * len(clay.data.points), rel=0.01)
    coarse, fine = heights(loop.shapes[-1], 0.005), heights(last, 0.0025)
    depths = [TOP - each.min() for each in (coarse, fine)]
    # The ball goes 7 mm deep.
    assert depths[0] > 0.003
    assert depths[0] <= depths[1] + 1e-4 <= 0.0071
    assert depths[1] - depths[0] < 0.5 * 0.005
    assert np.abs(fine - coarse).mean() < 0.25 * 0.005


def _record_edits(studio: Any, folder: Path) -> Loop:
    """Record a take in which a heap is added, a corner removed, and a face painted red."""
    studio_scene(studio, folder, rate=60)
    loop = Loop(studio.scene)
    for edits in (
        [Edit("add", (0.0, 0.0, TOP), 0.012), Edit("add", (0.004, 0.0, TOP), 0.012)],
        [Edit("remove", (0.02, 0.02, TOP), 0.013)],
        [Edit("paint", (-0.02, 0.0, 0.02), 0.015, color=(1.0, 0.0, 0.0, 1.0))],
    ):
        for _ in range(4):
            loop.step()
        loop.edit(*edits)
    for _ in range(4):
        loop.step()
    loop.finish()
    return loop


def _distinct(points: NDArray[np.float32]) -> NDArray[np.int64]:
    """Index of the first particle at each distinct position."""
    return np.sort(np.unique(points, axis=0, return_index=True)[1])


def test_edits_are_made_again(studio: Any, tmp_path: Path) -> None:
    """The film repeats adding, removing and painting, even if its bake is stopped and resumed."""
    loop = _record_edits(studio, tmp_path)
    live = loop.shapes[-1]
    film = make_film(bpy.context, spacing=0.005)
    (fine,) = clay_objects(film)
    room = len(fine.data.points) - len(loop.shapes[0])
    assert 0 < room < 300
    result, last = baked(film)
    there = _distinct(last)
    assert len(there) == len(live)
    np.testing.assert_allclose(
        np.sort(last[there], axis=0), np.sort(live, axis=0), atol=0.05 * 0.005
    )
    first = Cache(result.directory).read_frame(1).positions
    assert len(_distinct(first)) == len(loop.shapes[0])
    colors = clay_colors(fine)
    red = colors[there, 1] < 0.1
    assert red.sum() == (loop.simulation.colors[:, 1] < 0.1).sum() > 5
    assert last[there][red][:, 0].max() < -0.01
    film.frame_set(film.frame_end)
    _, count, _ = clay_surface(bpy.context, [fine])
    assert count == len(live)
    # Stopped after the clay was taken away, and resumed.
    whole = {each.name: each.read_bytes() for each in result.directory.glob("frame_*")}
    stopped = bake(bpy.context, progress=lambda progress: progress.frame < 10)
    assert stopped.cancelled and stopped.baked == 10
    assert bpy.ops.clay.resume() == {"FINISHED"}
    again = {each.name: each.read_bytes() for each in result.directory.glob("frame_*")}
    assert again == whole
    np.testing.assert_array_equal(clay_colors(fine), colors)


def test_finer_clay_is_edited_as_much(studio: Any, tmp_path: Path) -> None:
    """At half the spacing, edits add and remove the volume of their spheres."""
    loop = _record_edits(studio, tmp_path)
    film = make_film(bpy.context)
    result, last = baked(film)
    # The tool stands where clay is added.
    assert all("inside 'Ball'" in text for text in result.warnings)
    # A block, half of two balls that overlap, less an eighth of another.
    lens = np.pi * (4 * 0.012 + 0.004) * (2 * 0.012 - 0.004) ** 2 / 12
    added = 0.5 * (2 * 4 / 3 * np.pi * 0.012**3 - lens)
    whole = TOP**3 + added - 4 / 3 * np.pi * 0.013**3 / 8
    errors = [
        len(loop.shapes[-1]) * 0.005**3 / whole - 1,
        len(_distinct(last)) * 0.0025**3 / whole - 1,
    ]
    assert abs(errors[1]) < 0.02 and abs(errors[1]) < abs(errors[0])


def test_film_is_separate_from_the_scene(studio: Any, tmp_path: Path) -> None:
    """The film shares other objects with the original scene, but has its own clay and tools."""
    clay, item = studio_scene(studio, tmp_path, rate=60)
    scene = studio.scene
    props = bpy.data.collections.new("Props")
    scene.collection.children.link(props)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    only = bpy.data.collections.new("Only Clay")
    scene.collection.children.link(only)
    for collection, each in ((props, lamp), (props, clay), (only, clay)):
        collection.objects.link(each)
    scene.collection.objects.unlink(clay)
    clay.tactile_clay.yield_stress = 1234.0
    loop = Loop(scene)
    record_press(loop, item, 0.1)
    loop.finish()
    film = make_film(bpy.context)
    assert bpy.context.scene == scene
    (fine,) = clay_objects(film)
    assert fine.name == "Clay (film)"
    assert fine.tactile_clay.yield_stress == 1234.0
    assert fine.tactile_clay.spacing == pytest.approx(0.0025)
    assert clay.name not in film.objects and clay.name in scene.objects
    # The film has no copy of a collection that contains only clay.
    assert {each.name for each in film.collection.children} == {"Props.001", "Film"}
    assert {each.name for each in scene.collection.children} == {"Props", "Only Clay"}
    assert fine.name not in scene.objects
    assert lamp.name in film.objects and lamp.name in scene.objects
    copy = next(each for each in collider_objects(film) if each.name.startswith("Ball"))
    assert copy != item and copy.animation_data.action == item.animation_data.action
    assert item.name not in film.objects
    # Another spacing replaces the clay in the same scene.
    again = make_film(bpy.context, spacing=0.004, substeps=6)
    assert again == film and len(bpy.data.scenes) == 2
    (finer,) = clay_objects(film)
    assert finer.tactile_clay.spacing == pytest.approx(0.004)
    assert len([each for each in film.objects if each.name.startswith("Ball")]) == 1
    assert film.tactile_clay.substeps == 6
    assert lamp.name in film.objects
    # The film may also be the active scene.
    bpy.context.window.scene = film
    assert make_film(bpy.context) == film
    assert film.tactile_clay.cache_directory == "//clay_cache_film"


def test_operator_bakes_the_film(studio: Any, tmp_path: Path) -> None:
    """Bake Again activates and bakes the film; it needs a take without unknown edits."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    with pytest.raises(RuntimeError, match="There is no take in the scene 'Scene'"):
        bpy.ops.clay.bake_again()
    loop = Loop(studio.scene)
    record_press(loop, item, 0.1)
    loop.recorder.edit("sing", {"pitch": 440.0})
    loop.finish()
    with pytest.raises(RuntimeError, match=r"an edit of the kind 'sing' at 0\.10 s"):
        bpy.ops.clay.bake_again()
    assert len(bpy.data.scenes) == 1
    studio.scene.tactile_clay.take_edits = ""
    assert bpy.ops.clay.bake_again(spacing=0.005) == {"FINISHED"}
    assert bpy.context.scene.name == "Scene film"
    assert len(Cache(tmp_path / "clay_cache_film").frames()) == 7
    assert len(Cache(tmp_path / "clay_cache_take_001").frames()) == 7


def test_take_is_not_overwritten(studio: Any, tmp_path: Path) -> None:
    """A take's folder cannot be baked into or freed, and is never stale."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.1)
    loop.finish()
    for operator in (bpy.ops.clay.bake, bpy.ops.clay.resume, bpy.ops.clay.free):
        with pytest.raises(RuntimeError, match="holds a recorded take"):
            operator()
    table = scene_status(bpy.context, None)
    assert table["bake"]["stale"] == table["bake"]["problem"] == ""
    state, warning = cache_state(studio.scene, Cache(tmp_path / "clay_cache_take_001"))
    assert "A recorded take of 7 frames" in state and warning == ""


def test_take_is_baked_again_from_the_command_line(
    studio: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command makes, bakes and saves the film, and can resume it."""
    _, item = studio_scene(studio, tmp_path, rate=60)
    loop = Loop(studio.scene)
    record_press(loop, item, 0.1)
    blend = str(studio.save(tmp_path))
    assert main(["bake", blend, "--again"]) == 1
    assert "There is no take" in capsys.readouterr().err
    bpy.ops.wm.open_mainfile(filepath=blend)
    loop.scene = studio.scene
    loop.finish()
    studio.save(tmp_path)
    assert main(["bake", blend, "--spacing", "4"]) == 2
    assert main(["bake", blend, "--again", "--spacing", "4", "--substeps", "5", "--json"]) == 0
    table = printed(capsys)
    assert table["baked"] == 7 and table["settings"]["substeps"] == 5
    assert table["particle_count"] == pytest.approx((TOP / 0.004) ** 3, rel=0.02)
    assert main(["bake", blend, "--again", "--resume", "--json"]) == 0
    assert printed(capsys)["kept"] == 7
    assert len(bpy.data.scenes) == 2


def test_hands_move_in_the_film_as_they_did_live(studio: Any, tmp_path: Path) -> None:
    """A hand that gives way and is lost is replayed, with ghosts as dense as the finer clay."""
    scene = studio.scene
    scene.render.fps = 60
    clay = studio.clay(location=(0.0, 0.0, 0.02))
    studio.table()
    scene.cursor.location = (0.036, -0.155, 0.073)
    assert bpy.ops.clay.hand_add(side="RIGHT") == {"FINISHED"}
    armature = bpy.context.object
    (hand,) = hand_objects(scene)
    armature[CONTACT_PROPERTY] = 1.0
    bone = armature.pose.bones["index_proximal"]
    studio.save(tmp_path)
    loop = Loop(scene)
    poses = [armature.matrix_world @ bone.matrix]
    for number in range(1, 17):
        bone.rotation_mode = "XYZ"
        bone.rotation_euler.x = np.radians(-35.0 * min(number / 10, 1.0))
        armature[CONTACT_PROPERTY] = 1.0 if number < 14 else 0.0
        armature.update_tag()
        loop.step()
        poses.append(armature.matrix_world @ bone.matrix)
    loop.finish()
    assert np.abs(loop.shapes[-1] - loop.shapes[0]).max() > 0.003
    for frame in (1, 6, 13, 17):
        scene.frame_set(frame)
        shown = armature.matrix_world @ bone.matrix
        np.testing.assert_allclose(np.array(shown), np.array(poses[frame - 1]), atol=1e-6)
        assert armature[CONTACT_PROPERTY] == (1.0 if frame < 15 else 0.0)
    film = make_film(bpy.context, spacing=clay.tactile_clay.spacing)
    assert hand_objects(film)[0].data == hand.data
    _, last = baked(film)
    np.testing.assert_allclose(last, loop.shapes[-1], atol=0.02 * 0.01)
    film = make_film(bpy.context)
    (finer,) = hand_objects(film)
    assert finer.data != hand.data and finer.parent != armature
    assert hand_message(film, finer) == "" and hand_message(scene, hand) == ""
    bpy.context.window.scene = film
    film.frame_set(1)
    simulation = Simulation(bpy.context)
    assert simulation.warnings() == []
    assert len(simulation.hands[0].rig.ghost_areas) > 1.5 * len(
        loop.simulation.hands[0].rig.ghost_areas
    )


@pytest.mark.skipif(not LEAP.exists(), reason="needs a recording from outside the repository")
def test_two_tracked_hands_are_recorded_and_replayed(studio: Any, tmp_path: Path) -> None:
    """Tracked hands have the same poses in the take and in the film."""
    scene = studio.scene
    scene.render.fps = 60
    studio.clay(location=(0.0, 0.0, 0.02))
    assert bpy.ops.clay.hand_add(side="BOTH") == {"FINISHED"}
    hands = {("left" if "Left" in each.name else "right"): each for each in hand_objects(scene)}
    armatures = {side: each.parent for side, each in hands.items()}
    entries = [entry for entry in read_recording(LEAP) if entry.time < 8e8]
    imported = import_recording(scene, entries, armatures, start=1)
    studio.save(tmp_path)
    first = imported.first + 20
    scene.frame_set(first)
    loop = Loop(scene)
    names = ("wrist", "index_tip", "thumb_tip")
    seen = []
    for frame in range(first, first + 20):
        scene.frame_set(frame)
        if frame > first:
            loop.step()
        seen.append(_poses(armatures, names))
    loop.finish()
    moved = np.abs(seen[-1] - seen[0]).max()
    assert moved > 1e-3
    for number in (0, 7, 19):
        scene.frame_set(scene.frame_start + number)
        np.testing.assert_allclose(_poses(armatures, names), seen[number], atol=2e-6)
    film = make_film(bpy.context, spacing=0.01)
    bpy.context.window.scene = film
    film.frame_set(film.frame_start + 7)
    copies = {
        side: each.parent for side, each in zip(("left", "right"), hand_objects(film), strict=True)
    }
    np.testing.assert_allclose(_poses(copies, names), seen[7], atol=2e-6)


def _poses(armatures: dict[str, Any], names: tuple[str, ...]) -> NDArray[np.float64]:
    """World matrices of the named bones of all armatures."""
    return np.array(
        [
            armature.matrix_world @ armature.pose.bones[name].matrix
            for _, armature in sorted(armatures.items())
            for name in names
        ]
    )
