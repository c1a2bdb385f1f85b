# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch in Blender: the array object, the connection, the recording and the overlay."""

import importlib.util
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector

import tactile_clay.haptics
from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.core.storage.cache import Cache, CacheDamagedError, CacheMissingError
from tactile_clay.clay_addon.core.storage.foci import FociFrame, read_foci, write_foci
from tactile_clay.clay_addon.touch import connection as touch_connection
from tactile_clay.clay_addon.touch import overlay as touch_overlay
from tactile_clay.clay_addon.touch import panel as touch_panel
from tactile_clay.clay_addon.touch import record as touch_record
from tactile_clay.clay_addon.touch.array import TouchArrayError, placed_array
from tactile_clay.clay_addon.touch.connection import touch
from tactile_clay.clay_addon.touch.operators import field_picture
from tactile_clay.clay_addon.touch.properties import device_name
from tactile_clay.haptics import Foci, TransducerArray, acoustic_field
from tactile_clay.haptics.foci.pipeline import TouchFrame
from tactile_clay.tests.clay_addon.test_panel import Layout

PATIENCE = 20.0
PIXELS = 128


def foci_at(points: np.ndarray, pressures: Any, sigma: float = 0.00865) -> Foci:
    """Focal points without a field."""
    return Foci(points, np.array(pressures), np.zeros(0, np.intp), sigma)


def frame_at(height: float, pressure: float = 800.0) -> TouchFrame:
    """Two focal points over the origin, and some skin around them."""
    side = np.linspace(-0.04, 0.04, 21)
    skin = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    skin = np.column_stack((skin, np.full(len(skin), height)))
    points = np.array(((-0.02, 0.0, height), (0.02, 0.01, height)))
    square = np.square(skin[:, None] - points).sum(2).min(1)
    pressures = pressure * np.exp(-0.5 * square / 0.00865**2)
    return TouchFrame(foci_at(points, (pressure, 0.6 * pressure)), skin, pressures, pressures)


def add_array(preset: str = "sonicsurface") -> Any:
    """Add an array at the 3D cursor."""
    assert bpy.ops.clay.array_add(preset=preset) == {"FINISHED"}
    return bpy.context.object


def feel_until(scene: Any, frame: TouchFrame, until: Any, what: str) -> None:
    """Send the same frame at the rate of a live scene until a condition is true."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        touch.send(scene, frame)
        if until():
            return
        time.sleep(1 / 60)
    raise AssertionError(f"{what} did not happen; the server's status is {touch.status}")


def test_an_array_object_has_its_real_size(studio: Any) -> None:
    """Make 256 discs of the right size and position with any unit scale."""
    studio.scene.unit_settings.scale_length = 0.01
    item = add_array()
    assert studio.scene.tactile_touch.array == item
    assert item.hide_render
    places = np.array([vertex.co for vertex in item.data.vertices])[: 256 * 12].reshape(256, 12, 3)
    array = TransducerArray.preset("sonicsurface")
    assert places.mean(axis=1) * 0.01 == pytest.approx(array.positions, abs=1e-6)
    assert len(item.data.polygons) == 256


def test_the_array_has_the_pose_of_its_object(studio: Any) -> None:
    """Take position and rotation from the object, in meters, and refuse one that is scaled."""
    assert placed_array(studio.scene) is None
    studio.scene.unit_settings.scale_length = 0.5
    item = add_array("openmpd")
    item.matrix_world = Matrix.Translation((1.0, 0.0, 2.0)) @ Matrix.Rotation(np.pi / 2, 4, "Y")
    bpy.context.view_layer.update()
    array = placed_array(studio.scene)
    assert array is not None
    assert array.position == pytest.approx((0.5, 0.0, 1.0))
    assert array.normal == pytest.approx((1.0, 0.0, 0.0), abs=1e-6)
    item.scale = (2.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    with pytest.raises(TouchArrayError, match="Clear the scale"):
        placed_array(studio.scene)


def test_device_names_are_those_of_the_server(studio: Any) -> None:
    """Combine kind, address and options."""
    properties = studio.scene.tactile_touch
    assert device_name(properties) == "simulated"
    add_array("autd3")
    assert device_name(properties) == "simulated:autd3"
    properties.kind, properties.port, properties.firmware = "SONICSURFACE", "/dev/tty1", "tactile"
    assert device_name(properties) == "sonicsurface:/dev/tty1,firmware=tactile"
    properties.kind, properties.board = "ULTRAINO", "fpga"
    assert device_name(properties) == "ultraino:/dev/tty1,board=fpga"
    properties.kind, properties.board_file = "OPENMPD", "/tmp/board_1.pat"
    assert device_name(properties) == "openmpd:/tmp/board_1.pat"
    properties.kind = "AUTD3"
    assert device_name(properties) == "autd3:"


def test_a_frame_is_emitted_by_an_array_away_from_the_origin(studio: Any) -> None:
    """Connect, produce the requested pressures in the world, and be silent afterward."""
    item = add_array("openmpd")
    item.location = (0.3, -0.2, 0.1)
    bpy.context.view_layer.update()
    assert bpy.ops.clay.touch_connect() == {"FINISHED"}
    assert touch.client is not None
    near = frame_at(0.25)
    away = np.array((0.3, -0.2, 0.0))
    foci = foci_at(near.foci.positions + away, near.foci.pressures)
    near = TouchFrame(foci)

    drives = []

    def sounds() -> bool:
        assert touch.client
        drives.append(touch.client.drive())
        return bool(touch.status and touch.status.foci == 2 and drives[-1].any())

    feel_until(studio.scene, near, sounds, "sound")
    drive = drives[-1]
    array = placed_array(studio.scene)
    assert array is not None
    heard = np.abs(acoustic_field(array, drive, foci.positions))
    assert heard / foci.pressures == pytest.approx(1.0, abs=0.05)
    assert "2 focal points" in touch_panel.status_lines()[0][0]
    process = touch.client.process
    assert process is not None
    assert bpy.ops.clay.touch_disconnect() == {"FINISHED"}
    assert process.returncode == 0
    assert touch.client is None


def test_opening_another_file_and_unregistering_disconnect(studio: Any) -> None:
    """End the server when another file is opened, and when the add-on is unregistered."""
    assert bpy.ops.clay.touch_connect() == {"FINISHED"}
    first = touch.client.process if touch.client else None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert touch.client is None
    assert first is not None
    assert first.returncode == 0
    assert bpy.ops.clay.touch_connect() == {"FINISHED"}
    second = touch.client.process if touch.client else None  # type: ignore[unreachable]
    tactile_clay.unregister()
    tactile_clay.register()
    assert second is not None
    assert second.returncode == 0


def test_a_server_that_was_started_by_hand_is_used_and_left_running(studio: Any) -> None:
    """Connect to a port, and leave the server silent and running."""
    properties = studio.scene.tactile_touch
    properties.kind, properties.server_port = "SERVER", 9
    assert "No array server answers on port 9" in studio.refused(bpy.ops.clay.touch_connect)
    assert touch.client is None
    command = "from tactile_clay.clay_addon.command.line import run; run()"
    words = ["array-server", "simulated:openmpd", "--port", "0"]
    with subprocess.Popen(
        [sys.executable, "-c", command, *words], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        properties.server_port = int(process.stdout.readline().rsplit(":", 1)[1])
        add_array("openmpd")
        for _ in range(2):
            assert bpy.ops.clay.touch_connect() == {"FINISHED"}
            feel_until(
                studio.scene,
                frame_at(0.2),
                lambda: touch.status and touch.status.foci == 2,
                "sound",
            )
            touch.disconnect()
            assert process.poll() is None
        process.terminate()
        assert process.wait(PATIENCE) == 0


def test_a_device_that_cannot_be_made_is_reported(studio: Any) -> None:
    """Report the server's message, and stay disconnected."""
    properties = studio.scene.tactile_touch
    properties.kind = "OPENMPD"
    assert "board_N.pat" in studio.refused(bpy.ops.clay.touch_connect)
    assert touch.client is None


def test_missing_packages_are_reported(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Show in the panel what a device needs, and refuse to connect without it."""
    studio.scene.tactile_touch.kind = "SONICSURFACE"
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert "pyserial, which is missing" in drawn()
    assert "pyserial, which is missing" in studio.refused(bpy.ops.clay.touch_connect)
    studio.scene.tactile_touch.kind = "AUTD3"
    assert "choose Running Server" in drawn()
    studio.scene.tactile_touch.kind = "SIMULATED"
    assert "missing" not in drawn()


def drawn() -> str:
    """Draw the panel and return its texts."""
    layout = Layout([])
    draw: Any = touch_panel.CLAY_PT_touch.draw
    draw(SimpleNamespace(layout=layout), bpy.context)
    return " ".join(layout.texts)


STATUS = {"heard": True, "connected": True}


@pytest.mark.parametrize(
    ("status", "said"),
    [
        ({}, "Waiting for the server"),
        ({"fault": "The array server has ended."}, "has ended"),
        ({"heard": True, "fault": "No such port."}, "not connected"),
        ({"heard": True, "emitting": True}, "Switch off its power"),
        (STATUS, "Connected and silent"),
        (
            STATUS | {"emitting": True, "foci": 1, "latency": 0.0123},
            "1 focal point, 0 frames/s, latency 12",
        ),
        (STATUS | {"outside": 3}, "3 focal points outside"),
        (STATUS | {"dropped": 4}, "4 frames replaced"),
    ],
)
def test_the_panel_shows_the_status(
    studio: Any, monkeypatch: pytest.MonkeyPatch, status: dict, said: str
) -> None:
    """Show the server's status in the user's words."""
    from tactile_clay.haptics import ArrayStatus

    monkeypatch.setattr(touch, "client", SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(touch, "status", ArrayStatus(**status))
    assert said in drawn()


def test_focal_points_are_recorded_with_the_bake(studio: Any, tmp_path: Path) -> None:
    """Write, read, list and free them with the frames, and refuse damaged files."""
    studio.falling_block(tmp_path, end=2)
    result = bake(bpy.context)
    cache = Cache(result.directory)
    before = cache.size()
    frame = frame_at(0.2)
    touch_record.record_touch(cache, 2, frame, cache.meta(), scale=0.5)
    assert cache.foci_frames() == [2]
    assert cache.size() > before
    kept = touch_record.recorded_touch(cache, 2, scale=0.5).foci
    assert kept.positions == pytest.approx(frame.foci.positions, abs=1e-7)
    assert kept.pressures == pytest.approx(frame.foci.pressures)
    assert kept.sigma == pytest.approx(frame.foci.sigma)
    with pytest.raises(CacheMissingError):
        read_foci(cache.directory, 1, cache.meta())
    path = cache.directory / "foci_000002.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CacheDamagedError):
        read_foci(cache.directory, 2, cache.meta())
    bad = FociFrame(2, np.full((1, 3), np.nan, np.float32), np.ones(1, np.float32), 0.01)
    write_foci(cache.directory, bad, cache.meta())
    with pytest.raises(CacheDamagedError, match="not finite"):
        read_foci(cache.directory, 2, cache.meta())
    cache.free()
    assert not path.exists()


def test_recorded_touch_is_replayed(studio: Any, tmp_path: Path) -> None:
    """Send the recorded focal points during playback, without simulating."""
    studio.falling_block(tmp_path, end=3)
    add_array("openmpd")
    cache = Cache(bake(bpy.context).directory)
    for number, height in ((1, 0.2), (2, 0.25)):
        touch_record.record_touch(cache, number, frame_at(height), cache.meta(), scale=1.0)
    assert bpy.ops.clay.touch_connect() == {"FINISHED"}
    end = time.monotonic() + PATIENCE
    while not (touch.status and touch.status.emitting) and time.monotonic() < end:
        for number in (2, 1):
            studio.scene.frame_set(number)
            time.sleep(0.01)
    assert touch.status
    assert touch.status.foci == 2
    assert touch.shown is not None
    assert touch.shown.foci.positions[0, 2] == pytest.approx(0.2)
    touch_record.replay.paused = True
    studio.scene.frame_set(2)
    assert touch.shown.foci.positions[0, 2] == pytest.approx(0.2)
    touch_record.replay.paused = False
    studio.scene.frame_set(3)
    assert touch.shown is None


def test_a_picture_of_the_field_lies_in_the_plane_of_the_palm(studio: Any) -> None:
    """Make an image in the plane of the skin that is brightest at the strongest focal point."""
    assert "no array" in studio.refused(bpy.ops.clay.touch_picture)
    add_array("openmpd")
    assert "no focal points" in studio.refused(bpy.ops.clay.touch_picture)
    frame = frame_at(0.2)
    touch.show(frame)
    item = field_picture(studio.scene)
    bpy.context.view_layer.update()
    pixels = np.empty(PIXELS * PIXELS * 4, np.float32)
    item.data.pixels.foreach_get(pixels)
    bright = pixels.reshape(PIXELS, PIXELS, 4)[:, :, :3].sum(2)
    row, column = np.unravel_index(np.argmax(bright), bright.shape)
    local = (np.array((column, row)) + 0.5) / PIXELS - 0.5
    place = item.matrix_world @ Vector((*(0.16 * local), 0.0))
    assert tuple(place) == pytest.approx(frame.foci.positions[0], abs=0.004)
    assert 700.0 < item.data["largest_pressure"] < 1100.0
    assert bpy.ops.clay.touch_picture() == {"FINISHED"}


def test_a_frame_without_an_array_is_none(studio: Any) -> None:
    """Compute nothing if the scene has no array."""
    assert touch.touch_frame(studio.scene, []) is None
    assert touch.shown is None


@pytest.mark.skipif(
    not hasattr(tactile_clay.haptics, "PressureField"), reason="there is no pressure field yet"
)
def test_contacts_become_focal_points(studio: Any) -> None:
    """Put focal points where a palm is pressed, none above the ceiling, and reset at rest."""
    from tactile_clay.tests.bench.touch_latency import palm_contacts

    add_array("openmpd")
    studio.scene.tactile_touch.ceiling = 600.0
    studio.scene.tactile_touch.focus_count = 4
    for number in range(5):
        frame = touch.touch_frame(studio.scene, [palm_contacts(number)], dt=1 / 60)
    assert frame is not None
    assert 1 <= frame.foci.count <= 4
    assert frame.foci.pressures.max() <= 600.0
    assert np.hypot(*frame.foci.positions[:, :2].T).max() < 0.06
    assert frame.reconstructed is not None
    assert touch.shown is frame
    kept = touch.touch_frame(studio.scene, [palm_contacts(5)], dt=1 / 60, send=False)
    assert touch.shown is kept
    touch.rest()
    assert touch.shown is None


def test_a_live_frame_places_its_array_once(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compute the array's pose once for each frame that is sent."""
    add_array("openmpd")
    assert bpy.ops.clay.touch_connect() == {"FINISHED"}
    placed = []

    def count(scene: Any) -> Any:
        placed.append(placed_array(scene))
        return placed[-1]

    monkeypatch.setattr(touch_connection, "placed_array", count)
    assert touch.touch_frame(studio.scene, []) is not None
    assert len(placed) == 1
    touch.disconnect()


def test_there_is_no_overlay_in_background_mode() -> None:
    """Add no draw handler if there is no 3D Viewport."""
    assert bpy.app.background
    touch_overlay.register()
    assert not touch_overlay._drawing.active
    touch_overlay.unregister()


def test_rings_are_as_large_as_focal_points() -> None:
    """Draw a ring with radius sigma around each focal point, perpendicular to the sound."""
    foci = frame_at(0.2).foci
    lines, triangles = touch_overlay.focus_rings(foci, np.array((0.0, 0.0, 1.0)))
    for ring, place in zip(lines, foci.positions, strict=True):
        assert np.linalg.norm(ring - place, axis=1) == pytest.approx(foci.sigma, rel=1e-4)
        assert ring[:, 2] == pytest.approx(place[2])
    assert triangles.shape == (2, 96, 3)


DRAW = """
import os, sys
import bpy, gpu
import numpy as np
try:
    gpu.init()
    screen = gpu.types.GPUOffScreen(64, 64)
except (AttributeError, RuntimeError, SystemError) as error:
    print("no GPU:", error)
    sys.stdout.flush()
    os._exit(0)
from mathutils import Matrix
from tactile_clay.clay_addon.touch import overlay as touch_overlay
from tactile_clay.haptics import Foci
from tactile_clay.haptics.foci.pipeline import TouchFrame
side = np.linspace(-0.4, 0.4, 40)
skin = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
skin = np.column_stack((skin, np.full(len(skin), 0.3)))
felt = np.where(skin[:, 0] < 0.0, 1000.0, 0.0)
foci = Foci(np.array(((0.5, 0.5, 0.0),)), np.array((500.0,)), np.zeros(0, int), 0.2)
frame = TouchFrame(foci, skin, felt, felt)
with screen.bind():
    buffer = gpu.state.active_framebuffer_get()
    buffer.clear(color=(0, 0, 0, 1), depth=1.0)
    with gpu.matrix.push_pop():
        gpu.matrix.load_matrix(Matrix.Identity(4))
        gpu.matrix.load_projection_matrix(Matrix.Identity(4))
        touch_overlay.draw_frame(frame, np.array((0.0, 0.0, 1.0)), scale=1.0, ceiling=1000.0)
    read = buffer.read_color(0, 0, 64, 64, 4, 0, "UBYTE")
    read.dimensions = 64 * 64 * 4
    pixels = np.array(read, np.uint8).reshape(64, 64, 4)[:, :, :3].sum(2)
left, right, ring = pixels[20:44, 20:31], pixels[20:44, 36:42], pixels[46:50, 46:50]
print("drawn:", left.mean() > 200, right.max() == 0, ring.min() > 50, pixels[:8, :8].max() == 0)
sys.stdout.flush()
os._exit(0)
"""


def test_the_overlay_draws_pressed_skin_and_focal_points() -> None:
    """Draw pressed skin brightly, untouched skin not at all, and a disc at a focal point."""
    result = subprocess.run(
        [sys.executable, "-c", DRAW], capture_output=True, text=True, timeout=120
    )
    if "drawn" not in result.stdout:
        assert "no GPU" in result.stdout, result.stderr
        pytest.skip(result.stdout.strip())
    assert "drawn: True True True True" in result.stdout
