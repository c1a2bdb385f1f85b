# SPDX-License-Identifier: GPL-3.0-or-later
"""What was baked is what playback, packed files, deliveries and pictures show, by any clock."""

import itertools
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray

from tactile_clay.clay_addon.bake.bake import BakeError, bake
from tactile_clay.clay_addon.base.clock import animation_time
from tactile_clay.clay_addon.command.line import main
from tactile_clay.clay_addon.core.storage.cache import Cache, Frame
from tactile_clay.clay_addon.core.surface.exact import reconstruct
from tactile_clay.clay_addon.deliver.delivery import DeliveryError, deliver
from tactile_clay.clay_addon.deliver.object import delivered_object
from tactile_clay.clay_addon.deliver.render_frames import render_frames
from tactile_clay.clay_addon.playback.pack import pack_bake, unpack
from tactile_clay.clay_addon.playback.packed import MODIFIER_NAME as PLAYBACK
from tactile_clay.clay_addon.playback.poses import MODIFIER_NAME as POSES
from tactile_clay.clay_addon.playback.poses import key_pose, pose_at, pose_times

SPACING = 0.01
PIXEL = 0.005
"""Width of a pixel of the pictures [m]."""


def moved_bake(folder: Path, *, start: int = 1, end: int = 4) -> dict[int, NDArray[np.float32]]:
    """Bake the scene, then put frames in its cache that go on by 2 cm along x, of odd shapes."""
    cache = Cache(bake(bpy.context, start=start, end=end).directory)
    meta = cache.meta()
    rng = np.random.default_rng(0)
    frames = {}
    for number in cache.frames():
        frame = cache.read_frame(number)
        moved = frame.positions + rng.normal(0, 5e-4, frame.positions.shape)
        moved[:, 0] += 0.02 * (number - start)
        frames[number] = moved.astype(np.float32)
        cache.write_frame(Frame(number, frames[number], frame.velocities, frame.inputs), meta)
    bpy.context.scene.frame_set(start)
    return frames


def shown_points(item: bpy.types.Object) -> NDArray[np.float64]:
    """World positions of the particles that the viewport shows, without the look's surface."""
    for modifier in item.modifiers:
        modifier.show_viewport = modifier.name in (PLAYBACK, POSES)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = item.evaluated_get(depsgraph)
    geometry = evaluated.evaluated_geometry()
    cloud = geometry.pointcloud
    positions = np.empty((len(cloud.points), 3), np.float32)
    cloud.attributes["position"].data.foreach_get("vector", positions.ravel())
    matrix = np.array(evaluated.matrix_world)
    return positions @ matrix[:3, :3].T + matrix[:3, 3]


def shown_vertices() -> NDArray[np.float32]:
    """Vertices of the delivery that the viewport shows."""
    item = delivered_object(bpy.context.scene)
    assert item is not None
    mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    positions = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions.ravel())
    return positions


def key_along_x(item: bpy.types.Object, distance: float) -> None:
    """Key an object to go along x from frame 1 to 4, evenly."""
    for frame, x in ((1, 0.0), (4, distance)):
        item.location.x = x
        item.keyframe_insert("location", index=0, frame=frame)
    for layer in item.animation_data.action.layers:
        for curve in layer.strips[0].channelbags[0].fcurves:
            for key in curve.keyframe_points:
                key.interpolation = "LINEAR"


def by_parent(clay: bpy.types.Object, mover: bpy.types.Object) -> None:
    """Parent the clay to what moves."""
    clay.parent = mover


def by_grandparent(clay: bpy.types.Object, mover: bpy.types.Object) -> None:
    """Parent the clay to a turned and scaled child of what moves."""
    between = bpy.data.objects.new("Between", None)
    bpy.context.collection.objects.link(between)
    between.parent = mover
    between.rotation_euler = (0.0, 0.0, 0.4)
    between.scale = (-1.0, 1.0, 1.0)
    clay.parent = between


def by_constraint(clay: bpy.types.Object, mover: bpy.types.Object) -> None:
    """Let the clay copy the place of what moves."""
    constraint = clay.constraints.new("COPY_LOCATION")
    constraint.target = mover
    constraint.use_offset = True


def by_driver(clay: bpy.types.Object, mover: bpy.types.Object) -> None:
    """Drive the clay's place by that of what moves."""
    driver = clay.driver_add("location", 0).driver
    variable = driver.variables.new()
    variable.targets[0].id = mover
    variable.targets[0].data_path = "location[0]"
    driver.expression = variable.name


def by_strip(clay: bpy.types.Object, mover: bpy.types.Object) -> None:
    """Play the mover's action on the clay as a strip."""
    clay.animation_data_create()
    track = clay.animation_data.nla_tracks.new()
    strip = track.strips.new("Move", 1, mover.animation_data.action)
    strip.action_slot = mover.animation_data.action_slot


def by_keys(clay: bpy.types.Object, mover: bpy.types.Object) -> None:
    """Key the clay itself."""
    key_along_x(clay, mover.location.x)


DRIVEN = [by_parent, by_grandparent, by_constraint, by_driver, by_strip, by_keys]


def picture_camera(scene: bpy.types.Scene) -> None:
    """Look along y at 64 × 16 pixels of half a centimeter."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0.1, -1, 0.03), (np.pi / 2, 0, 0)
    camera.data.type, camera.data.ortho_scale = "ORTHO", 64 * PIXEL
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = 64, 16
    scene.render.image_settings.color_mode = "RGBA"


def pictured_extent(path: Path) -> tuple[float, float]:
    """Where the clay begins and ends along x in a picture [m]."""
    image = bpy.data.images.load(str(path))
    alpha = np.array(image.pixels[:], np.float32).reshape(16, 64, 4)[..., 3].max(axis=0)
    columns = np.flatnonzero(alpha > 0.5)
    bpy.data.images.remove(image)
    assert len(columns), f"no clay in {path}"
    return 0.1 + (columns[0] - 32) * PIXEL, 0.1 + (columns[-1] + 1 - 32) * PIXEL


@pytest.mark.parametrize("drive", DRIVEN)
@pytest.mark.parametrize("packed", [False, True])
def test_an_animation_renders_clay_where_it_was_baked(
    studio: Any, tmp_path: Path, drive: Any, packed: bool
) -> None:
    """The clay's object may be moved by anything: its points are baked in the world."""
    clay = studio.clay()
    mover = bpy.data.objects.new("Mover", None)
    studio.scene.collection.objects.link(mover)
    key_along_x(mover, 0.5)
    studio.scene.gravity = (0, 0, 0)
    drive(clay, mover)
    studio.scene.frame_end = 4
    studio.scene.frame_set(1)
    picture_camera(studio.scene)
    studio.save(tmp_path)
    frames = moved_bake(tmp_path)
    if packed:
        pack_bake(studio.scene)
    for number in (1, 3, 4, 2):
        studio.scene.frame_set(number)
        np.testing.assert_allclose(shown_points(clay), frames[number], atol=2e-6)
    for modifier in clay.modifiers:
        modifier.show_viewport = True
    studio.scene.render.filepath = str(tmp_path / "picture_####.png")
    bpy.ops.render.render(animation=True)
    for number, positions in frames.items():
        low, high = pictured_extent(tmp_path / f"picture_{number:04d}.png")
        assert low == pytest.approx(positions[:, 0].min() - SPACING / 2, abs=1.5 * PIXEL)
        assert high == pytest.approx(positions[:, 0].max() + SPACING / 2, abs=1.5 * PIXEL)


CLOCKS = [
    {"frame_map_old": 100, "frame_map_new": 200},
    {"frame_map_old": 200, "frame_map_new": 100},
    {"frame_map_old": 100, "frame_map_new": 90},
    {"frame_map_old": 100, "frame_map_new": 300, "fps": 24, "fps_base": 1.001},
    {"fps": 30, "fps_base": 1.001},
    {"fps": 120},
]


def set_clock(scene: bpy.types.Scene, clock: dict[str, Any], step: int = 1) -> None:
    """Set time remapping, frame rate and step."""
    for name, value in clock.items():
        setattr(scene.render, name, value)
    scene.frame_step = step


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("start", [-6, -1, 0, 1, 1001])
def test_one_clock_for_cache_and_packed_frames(
    studio: Any, tmp_path: Path, clock: dict[str, Any], start: int
) -> None:
    """Both show a bake's own frame at each frame, and between two of them their mean."""
    clay = studio.clay()
    set_clock(studio.scene, clock, step=3)
    studio.save(tmp_path)
    frames = moved_bake(tmp_path, start=start, end=start + 3)
    for packed in (False, True):
        if packed:
            pack_bake(studio.scene)
        for number in (start - 2, *frames, start + 5):
            studio.scene.frame_set(number)
            wanted = frames[min(max(number, start), start + 3)]
            np.testing.assert_allclose(shown_points(clay), wanted, atol=2e-6)
        for fraction in (0.25, 0.5):
            studio.scene.frame_set(start + 1, subframe=fraction)
            wanted = (1 - fraction) * frames[start + 1] + fraction * frames[start + 2]
            np.testing.assert_allclose(shown_points(clay), wanted, atol=5e-6)
    # The remapping may be changed after packing.
    studio.scene.render.frame_map_new = 130
    studio.scene.frame_set(start + 2)
    np.testing.assert_allclose(shown_points(clay), frames[start + 2], atol=2e-6)
    studio.scene.tactile_clay.hold_frames = 2
    unpack(clay)
    pack_bake(studio.scene)
    for number, held in zip(range(start, start + 4), (0, 0, 2, 2), strict=True):
        studio.scene.frame_set(number)
        np.testing.assert_allclose(shown_points(clay), frames[start + held], atol=2e-6)


@pytest.mark.parametrize("kind", ["usd", "abc"])
@pytest.mark.parametrize(
    ("clock", "start"), [(CLOCKS[0], 1), (CLOCKS[1], -6), (CLOCKS[3], -2), ({}, -3), ({}, 1001)]
)
def test_a_delivery_goes_by_the_same_clock(
    studio: Any, tmp_path: Path, kind: str, clock: dict[str, Any], start: int
) -> None:
    """USD and Alembic show the surface of each baked frame at it, before frame 0 too."""
    studio.clay()
    set_clock(studio.scene, clock)
    studio.save(tmp_path)
    frames = moved_bake(tmp_path, start=start, end=start + 3)
    result = deliver(bpy.context, kind=kind, start=start, end=start + 3)
    assert result is not None
    assert result.file.is_file()
    shown = set()
    for number in (start, start + 2, start + 1, start + 3, start + 9):
        studio.scene.frame_set(number)
        wanted = reconstruct(frames[min(number, start + 3)], SPACING).vertices
        got = shown_vertices()
        assert len(got) == len(wanted)
        np.testing.assert_allclose(got.min(0), wanted.min(0), atol=1e-6)
        np.testing.assert_allclose(got.max(0), wanted.max(0), atol=1e-6)
        shown.add(got[:, 0].min())
    assert len(shown) == 4


@pytest.mark.parametrize("clock", CLOCKS[:4])
def test_keyed_poses_go_by_the_same_clock(
    studio: Any, tmp_path: Path, clock: dict[str, Any]
) -> None:
    """A pose keyed at a frame is seen from that frame on, in the viewport and in a delivery."""
    clay = studio.clay()
    set_clock(studio.scene, clock)
    studio.save(tmp_path)
    rest = studio.points(clay)
    local = rest - np.array(clay.location)
    keyed = dict(zip((2, 5, 8), itertools.count(1), strict=False))
    for frame, place in keyed.items():
        shape = (local + np.array([0.1 * place, 0, 0])).astype(np.float32)
        key_pose(clay, shape, time=animation_time(studio.scene, frame))
    assert len(pose_times(clay)) == 3
    for frame in range(2, 11):
        studio.scene.frame_set(frame)
        place = keyed[max(key for key in keyed if key <= frame)]
        np.testing.assert_allclose(
            shown_points(clay), rest + np.array([0.1 * place, 0, 0]), atol=1e-6
        )
        assert pose_at(clay, studio.scene.frame_current_final) is not None
    deliver(bpy.context, start=2, end=9)
    for frame in range(2, 10):
        studio.scene.frame_set(frame)
        place = keyed[max(key for key in keyed if key <= frame)]
        assert shown_vertices()[:, 0].mean() == pytest.approx(0.1 * place, abs=2e-3)


def test_pictures_of_negative_frames_are_on_the_disk(studio: Any, tmp_path: Path) -> None:
    """Each picture that is reported exists, has its frame's name, and shows its frame."""
    studio.clay()
    studio.scene.gravity = (0, 0, 0)
    picture_camera(studio.scene)
    studio.save(tmp_path)
    frames = moved_bake(tmp_path, start=-3, end=1)
    result = render_frames(
        bpy.context, range(-3, 2), output=str(tmp_path / "pictures" / "clay_####")
    )
    assert result.rendered == 5
    assert len(set(result.files)) == 5
    for path, (number, positions) in zip(result.files, frames.items(), strict=True):
        assert path.is_file(), path
        assert str(abs(number)) in path.stem
        low, _ = pictured_extent(path)
        assert low == pytest.approx(positions[:, 0].min() - SPACING / 2, abs=1.5 * PIXEL)
    again = render_frames(
        bpy.context, range(-3, 2), output=str(tmp_path / "pictures" / "clay_####"), resume=True
    )
    assert (again.rendered, again.kept) == (0, 5)
    assert again.files == result.files


def test_negative_ranges_are_words_of_the_command(studio: Any, tmp_path: Path) -> None:
    """With or without an equals sign, and each word of the help is true."""
    studio.clay()
    picture_camera(studio.scene)
    path = studio.save(tmp_path)
    assert main(["bake", str(path), "--frames", "-5--3"]) == 0
    assert Cache(tmp_path / "clay_cache").frames() == [-5, -4, -3] or Cache(
        next(tmp_path.glob("*cache*"))
    ).frames() == [-5, -4, -3]
    assert main(["deliver", str(path), "--frames=-5--4", "--output", str(tmp_path / "usd")]) == 0
    pictures = tmp_path / "pictures"
    words = ["render", str(path), "--frames", "-4--3", "--output", str(pictures / "a_####")]
    assert main(words) == 0
    assert len(list(pictures.iterdir())) == 2


def test_frames_that_blender_has_not_are_refused(
    studio: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Blender would clamp them without a word."""
    studio.clay()
    path = studio.save(tmp_path)
    with pytest.raises(BakeError, match="no frame 2,000,000"):
        bake(bpy.context, start=1, end=2_000_000)
    assert main(["bake", str(path), "--frames", "1-2000000"]) == 2
    assert "Blender has no frame" in capsys.readouterr().err
    bake(bpy.context, start=1, end=2)
    with pytest.raises(DeliveryError, match="no frame -2,000,000"):
        deliver(bpy.context, start=-2_000_000, end=1)
