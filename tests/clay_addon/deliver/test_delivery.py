# SPDX-License-Identifier: GPL-3.0-or-later
"""Delivery of files that stock Blender plays and renders like the bake."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.base import modal
from tactile_clay.clay_addon.base.activity import ActivityKind, clay_activity
from tactile_clay.clay_addon.base.modal import SteppedOperator
from tactile_clay.clay_addon.core.storage.cache import Cache, Frame
from tactile_clay.clay_addon.core.surface.exact import reconstruct
from tactile_clay.clay_addon.deliver import operators as delivery_operators
from tactile_clay.clay_addon.deliver.delivery import DeliveryError, deliver
from tactile_clay.clay_addon.deliver.files import FrameWriter
from tactile_clay.clay_addon.deliver.object import delivered_object, remove_delivery
from tactile_clay.clay_addon.model.clay_points import ABSENT, SCULPTED_MARK
from tactile_clay.clay_addon.sculpt.live.checks import SculptError, check_free

SPEED = 1.2
"""Speed of the moving clay [m/s]: it moves by more than its size per frame."""


def moving_bake(studio: Any, folder: Path, *, end: int = 4) -> dict[int, np.ndarray]:
    """Make a bake of clay that moves along x and loses its shape; return positions by frame."""
    studio.falling_block(folder, end=end)
    cache = Cache(bake(bpy.context).directory)
    meta = cache.meta()
    rng = np.random.default_rng(0)
    frames = {}
    for number in cache.frames():
        frame = cache.read_frame(number)
        moved = frame.positions + rng.normal(0, 0.001 * number, frame.positions.shape)
        moved[:, 0] += SPEED / 24 * (number - 1)
        frames[number] = moved.astype(np.float32)
        velocities = np.tile(np.array([SPEED, 0, 0], np.float32), (len(moved), 1))
        cache.write_frame(Frame(number, frames[number], velocities, frame.inputs), meta)
    studio.scene.frame_set(1)
    return frames


def expected(positions: np.ndarray) -> dict[str, Any]:
    """Vertex count, face count and bounds of the surface of a frame."""
    surface = reconstruct(positions, 0.01)
    bounds = [surface.vertices.min(axis=0).tolist(), surface.vertices.max(axis=0).tolist()]
    return {"vertices": len(surface.vertices), "faces": len(surface.faces), "bounds": bounds}


READ_BACK = """
import json, os, sys
import bpy, numpy as np
path, result_path, render = sys.argv[-3:]
bpy.ops.wm.open_mainfile(filepath=path)
scene = bpy.context.scene
item = bpy.data.objects["Clay Delivery"]
result = {"foreign": [name for name in sys.modules if name.startswith("tactile_clay")],
          "paths": [each.filepath for each in bpy.data.cache_files], "frames": {}}
for number in range(0, 7):
    scene.frame_set(number)
    mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    positions = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions.ravel())
    colors = np.empty((len(mesh.vertices), 4), np.float32)
    mesh.attributes["Color"].data.foreach_get("color", colors.ravel())
    result["frames"][number] = {
        "vertices": len(mesh.vertices), "faces": len(mesh.polygons),
        "bounds": [positions.min(axis=0).tolist(), positions.max(axis=0).tolist()],
        "color": colors.mean(axis=0).tolist(),
    }
widths = {}
if render == "render":
    scene.frame_set(3)
    for blurred in (False, True):
        scene.render.use_motion_blur = blurred
        scene.render.filepath = f"{result_path}.{blurred}.png"
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        alpha = np.array(image.pixels[:], np.float32).reshape(16, 64, 4)[..., 3].max(axis=0)
        widths[str(blurred)] = int((alpha > 0.02).sum())
result["widths"] = widths
with open(result_path, "w") as file:
    json.dump(result, file)
sys.stdout.flush()
os._exit(0)
"""


def read_back(folder: Path, *, render: bool = False) -> Any:
    """Read the .blend of a folder in a new process without the add-on."""
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    (folder / "read_back.py").write_text(READ_BACK)
    done = subprocess.run(
        [
            sys.executable,
            *(str(folder / name) for name in ("read_back.py", "scene.blend", "result.json")),
            "render" if render else "-",
        ],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (folder / "result.json").exists(), done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads((folder / "result.json").read_text())


def add_camera(studio: Any) -> None:
    """Add a camera in front of the clay at frame 3; 64 columns of pixels show 0.32 m."""
    scene = studio.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0.1, -1, 0.02), (np.pi / 2, 0, 0)
    camera.data.type, camera.data.ortho_scale = "ORTHO", 0.32
    scene.camera = camera
    bpy.data.objects["Table"].hide_render = True
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 32
    scene.cycles.use_denoising = False
    scene.render.motion_blur_shutter = 1.0
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = 64, 16
    scene.render.image_settings.color_mode = "RGBA"


def test_usd_plays_and_renders_with_motion_blur_without_the_addon(
    studio: Any, tmp_path: Path
) -> None:
    """Each frame has its own topology, position and color, and is blurred along its velocity."""
    frames = moving_bake(studio, tmp_path)
    add_camera(studio)
    result = deliver(bpy.context, points=True)
    assert result is not None
    assert (result.start, result.end, result.shapes, result.particle_count) == (1, 4, 4, 64)
    assert abs(result.volume_error) < 0.003
    assert result.bytes > 4 * result.bytes_per_shape * 0.9
    assert studio.scene.objects["Clay"].hide_render
    assert studio.scene.objects["Clay"].hide_get()
    found = read_back(tmp_path, render=True)
    assert found["foreign"] == []
    assert found["paths"] == ["//clay_delivery/clay.usda"]
    counts = set()
    for number in range(7):
        wanted = expected(frames[min(max(number, 1), 4)])
        got = found["frames"][str(number)]
        assert (got["vertices"], got["faces"]) == (wanted["vertices"], wanted["faces"])
        np.testing.assert_allclose(got["bounds"], wanted["bounds"], atol=1e-6)
        np.testing.assert_allclose(
            got["color"], studio.scene.objects["Clay"].data.attributes["Color"].data[0].color, 1e-5
        )
        counts.add(got["vertices"])
    assert len(counts) == 4
    # A column is 5 mm; the shutter is open for 50 mm.
    blur = found["widths"]["True"] - found["widths"]["False"]
    assert blur == pytest.approx(SPEED / 24 / 0.005, abs=2)


def test_usd_points_have_their_positions(studio: Any, tmp_path: Path) -> None:
    """The files also contain the particles; the object that plays them is not rendered."""
    frames = moving_bake(studio, tmp_path)
    deliver(bpy.context, points=True)
    cloud = studio.scene.objects["Clay Delivery Points"]
    assert cloud.hide_render
    cloud.hide_set(False)
    studio.scene.frame_set(3)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    geometry = cloud.evaluated_get(depsgraph).evaluated_geometry()
    points = geometry.pointcloud
    positions = np.empty((len(points.points), 3), np.float32)
    points.attributes["position"].data.foreach_get("vector", positions.ravel())
    np.testing.assert_array_equal(positions, frames[3])
    deliver(bpy.context)
    assert "Clay Delivery Points" not in studio.scene.objects


def test_alembic_plays_without_the_addon(studio: Any, tmp_path: Path) -> None:
    """A sequence of Alembic files shows the same surfaces, and holds the first and last."""
    frames = moving_bake(studio, tmp_path)
    deliver(bpy.context, kind="abc")
    found = read_back(tmp_path)
    assert found["paths"] == ["//clay_delivery/frames/clay_000001.abc"]
    color = studio.scene.objects["Clay"].data.attributes["Color"].data[0].color
    for number in range(7):
        wanted = expected(frames[min(max(number, 1), 4)])
        got = found["frames"][str(number)]
        assert (got["vertices"], got["faces"]) == (wanted["vertices"], wanted["faces"])
        np.testing.assert_allclose(got["bounds"], wanted["bounds"], atol=1e-6)
        np.testing.assert_allclose(got["color"], color, atol=0.01)


def test_held_shapes_are_written_once(studio: Any, tmp_path: Path) -> None:
    """Animation on twos has half as many files, and zero velocities."""
    frames = moving_bake(studio, tmp_path)
    studio.scene.tactile_clay.hold_frames = 2
    result = deliver(bpy.context)
    assert result is not None
    assert result.shapes == 2
    item = delivered_object(studio.scene)
    assert item is not None
    for number, shape in ((1, 1), (2, 1), (3, 3), (4, 3)):
        studio.scene.frame_set(number)
        mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        assert len(mesh.vertices) == expected(frames[shape])["vertices"]
        assert not any(any(value.vector) for value in mesh.attributes["velocity"].data)


def test_unit_scale_is_kept(studio: Any, tmp_path: Path) -> None:
    """In a scene in millimeters, the values are unchanged and the file states their unit."""
    studio.scene.unit_settings.scale_length = 0.001
    block = studio.block(size=40.0, location=(0, 0, 30))
    from tactile_clay.clay_addon.clay.make_clay import make_clay

    make_clay(bpy.context, [block], spacing=10.0)
    studio.save(tmp_path)
    deliver(bpy.context, start=1, end=1)
    assert "metersPerUnit = 0.001" in (tmp_path / "clay_delivery" / "clay.usda").read_text()
    item = studio.scene.objects["Clay Delivery"]
    mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    height = max(vertex.co.z for vertex in mesh.vertices)
    assert height == pytest.approx(50, abs=3)


def test_stopping_and_failing_change_nothing(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The earlier delivery stays intact, and nothing is left in the folder or the .blend."""
    moving_bake(studio, tmp_path)
    deliver(bpy.context)
    folder = tmp_path / "clay_delivery"
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    names = sorted(path.name for path in tmp_path.iterdir())
    blocks = [len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.scenes)]
    assert deliver(bpy.context, progress=lambda report: report.done < 2) is None

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(FrameWriter, "_export", fail)
    with pytest.raises(DeliveryError, match="No space left"):
        deliver(bpy.context)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert [len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.scenes)] == blocks


def test_delivering_again_keeps_changes_to_the_player(studio: Any, tmp_path: Path) -> None:
    """The same object plays the new files and keeps modifiers that were added to it."""
    moving_bake(studio, tmp_path)
    deliver(bpy.context)
    item = studio.scene.objects["Clay Delivery"]
    item.modifiers.new("Mine", "SUBSURF")
    (tmp_path / "clay_delivery" / "frames" / "clay_000001.usdc").unlink()
    result = deliver(bpy.context, end=2)
    assert result is not None
    assert result.object_name == item.name
    assert [each.name for each in item.modifiers][-1] == "Mine"
    assert len(bpy.data.cache_files) == 1
    assert sorted(p.name for p in (tmp_path / "clay_delivery" / "frames").iterdir()) == [
        "clay_000001.usdc",
        "clay_000002.usdc",
    ]
    with pytest.raises(SculptError, match="Show Clay Again"):
        check_free(studio.scene)
    (warning,) = bake(bpy.context).warnings
    assert "'Clay Delivery' still plays the files delivered before" in warning
    assert remove_delivery(studio.scene)
    check_free(studio.scene)
    assert not studio.scene.objects["Clay"].hide_render
    assert not studio.scene.objects["Clay"].hide_get()
    assert len(bpy.data.cache_files) == 0


def test_refusals_say_what_to_do(studio: Any, tmp_path: Path) -> None:
    """Missing clay, unusable folders, impossible ranges, formats and gaps are refused."""
    with pytest.raises(DeliveryError, match="no clay"):
        deliver(bpy.context, directory=tmp_path / "out")
    studio.clay()
    with pytest.raises(DeliveryError, match="never saved"):
        deliver(bpy.context)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(DeliveryError, match="files that are not part of a delivery"):
        deliver(bpy.context, directory=tmp_path)
    with pytest.raises(DeliveryError, match=r"ends .* before it starts"):
        deliver(bpy.context, start=4, end=2, directory=tmp_path / "out")
    with pytest.raises(DeliveryError, match="must be one of usd, abc"):
        deliver(bpy.context, kind="fbx", directory=tmp_path / "out")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    (tmp_path / "gap").mkdir()
    moving_bake(studio, tmp_path / "gap")
    Cache(tmp_path / "gap" / "clay_cache").frame_path(3).unlink()
    with pytest.raises(DeliveryError, match=r"Frame 3 is missing in the bake\. Press Resume"):
        deliver(bpy.context)
    assert not (tmp_path / "gap" / "clay_delivery").exists()


def test_sculpted_clay_is_not_delivered_as_its_bake(studio: Any, tmp_path: Path) -> None:
    """Clay that no longer plays its bake is refused, unless a pose is keyed."""
    moving_bake(studio, tmp_path)
    clay = studio.scene.objects["Clay"]
    clay.data[SCULPTED_MARK] = True
    with pytest.raises(DeliveryError, match="sculpted after it was baked"):
        deliver(bpy.context)
    studio.scene.frame_set(1)
    bpy.ops.clay.pose_key()
    result = deliver(bpy.context)
    assert result is not None
    assert result.shapes == 1


def test_absent_particles_are_left_out(studio: Any, tmp_path: Path) -> None:
    """Points of clay that has not been added yet are neither in the surface nor counted."""
    frames = moving_bake(studio, tmp_path)
    clay = studio.scene.objects["Clay"]
    clay.data.attributes.new(ABSENT, "BOOLEAN", "POINT")
    cache = Cache(tmp_path / "clay_cache")
    meta = cache.meta()
    frame = cache.read_frame(4)
    positions = frames[4].copy()
    positions[:14] = positions[14]
    cache.write_frame(Frame(4, positions, frame.velocities, frame.inputs), meta)
    result = deliver(bpy.context)
    assert result is not None
    assert result.particle_count == 50
    studio.scene.frame_set(4)
    item = studio.scene.objects["Clay Delivery"]
    mesh = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    assert len(mesh.vertices) == expected(np.unique(positions, axis=0))["vertices"]


class OperatorParts(SteppedOperator[Any, Any]):
    """The operator without its Blender base class, which only Blender can instantiate."""

    stopped_text = delivery_operators.CLAY_OT_deliver.stopped_text
    begin = delivery_operators.CLAY_OT_deliver.begin
    status = delivery_operators.CLAY_OT_deliver.status
    report_result = delivery_operators.CLAY_OT_deliver.report_result


def test_escape_in_a_window_changes_nothing(
    studio: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each timer event writes a frame and leaves no data-blocks, and Esc stops the delivery."""
    moving_bake(studio, tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    reports: list[str] = []
    operator = type("Operator", (OperatorParts,), {})()
    operator.report = lambda kind, text: reports.append(text)
    context: Any = SimpleNamespace(
        scene=studio.scene, window=object(), window_manager=MagicMock(), workspace=MagicMock()
    )
    app = SimpleNamespace(background=False)
    monkeypatch.setattr(modal, "bpy", SimpleNamespace(app=app))

    def press(kind: str) -> Any:
        return operator.modal(context, SimpleNamespace(type=kind, value="PRESS"))

    assert operator.invoke(context, None) == {"RUNNING_MODAL"}
    assert press("TIMER") == {"RUNNING_MODAL"}
    assert press("MOUSEMOVE") == {"PASS_THROUGH"}
    assert clay_activity.kind is ActivityKind.DELIVERY
    assert clay_activity.progress is not None
    assert clay_activity.progress.done == 2
    assert len(bpy.data.scenes) == 1
    assert press("ESC") == {"CANCELLED"}
    assert reports == ["Stopped. Nothing was changed."]
    assert clay_activity.kind is None
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert operator.invoke(context, None) == {"RUNNING_MODAL"}
    assert [press("TIMER") for _ in range(4)][-1] == {"FINISHED"}
    assert "Frames 1 to 4, 4 shapes" in reports[-1]


def test_operator_reports_size_and_time(
    studio: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The operator reports the delivery, which can be removed again."""
    assert not bpy.ops.clay.deliver.poll()
    moving_bake(studio, tmp_path, end=2)
    capfd.readouterr()
    assert bpy.ops.clay.deliver() == {"FINISHED"}
    assert "Frames 1 to 2, 2 shapes: " in capfd.readouterr().out
    assert bpy.ops.clay.deliver_remove() == {"FINISHED"}
    assert not bpy.ops.clay.deliver_remove.poll()
