# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of a shortened demo."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

bpy = pytest.importorskip("bpy")

from tactile_clay.clay_addon.command import demo, demo_picture, demo_scenes  # noqa: E402

DEMO = """
import os, sys
from tactile_clay.clay_addon.command import demo
code = demo.main(sys.argv[1:])
sys.stdout.flush()
os._exit(code)
"""

PLAYBACK = """
import os, sys
import bpy
import numpy as np
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
assert not hasattr(bpy.types.Scene, "tactile_clay")
scene = bpy.context.scene
clay = bpy.data.objects["Modeling clay"]
shapes = []
for frame in (scene.frame_start, scene.frame_end):
    scene.frame_set(frame)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh = next(
        item.object.data
        for item in depsgraph.object_instances
        if item.object.type == "MESH" and item.object.name == clay.name
    )
    assert len(mesh.polygons) > 1000
    shapes.append([corner for vertex in mesh.vertices for corner in vertex.co])
wrists = []
for frame in (scene.frame_start, scene.frame_end):
    scene.frame_set(frame)
    hand = bpy.data.objects["Right hand"].evaluated_get(bpy.context.evaluated_depsgraph_get())
    wrists.append(hand.matrix_world @ hand.data.vertices[0].co)
assert (wrists[0] - wrists[1]).length > 0.001
print("frames", scene.frame_start, scene.frame_end, scene.render.fps, shapes[0] != shapes[1])
sys.stdout.flush()
os._exit(0)
"""


def run(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=400
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    output = tmp_path_factory.mktemp("demo") / "made by the demo"
    words = ("--output", str(output), "--frames", "4", "--width", "48", "--samples", "1")
    return output, run(DEMO, *words)


def test_all_files_are_written_and_listed(
    made: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    """All files exist and are named in the output."""
    output, result = made
    assert result.returncode == 0, result.stderr
    for suffix in (".blend", ".stl", ".ply", ".glb", ".png"):
        path = output / f"kindergarten{suffix}"
        assert path.stat().st_size > 1000
        assert str(path) in result.stdout
    assert "Simulating, frame 4 of 4" in result.stderr
    assert "left" in result.stderr
    assert "Warp" not in result.stdout + result.stderr


def test_report_has_statistics(made: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    """The report has particles, frames, device, settings, durations and errors."""
    report = json.loads((made[0] / "report.json").read_text(encoding="utf-8"))
    assert report["particles"] == 2114
    assert report["frames"] == 4
    assert report["device"]
    assert report["settings"]["model"]
    pace = report["milliseconds_a_frame"]
    assert 0.0 < pace["median"] <= pace["percentile_90"]
    assert abs(report["volume_error"]) < 0.05
    assert abs(report["volume_error_of_exported_mesh"]) < 0.01
    assert 0.0 <= report["largest_penetration_m"] < 0.0025
    assert report["versions"]["warp"]


def test_exported_meshes_are_closed_and_colored(
    made: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    """Each format has the same closed surface, and PLY has its colors."""
    for suffix in demo.EXPORTS:
        mesh = trimesh.load(made[0] / f"kindergarten{suffix}", force="mesh")
        mesh.merge_vertices(merge_norm=True, merge_tex=True)
        assert mesh.is_watertight, suffix
        assert mesh.volume == pytest.approx(2114 * 0.005**3, rel=0.01)
    colors = trimesh.load(made[0] / "kindergarten.ply").visual.vertex_colors
    assert len(np.unique(colors // 64, axis=0)) >= 5


def test_blend_plays_without_the_extension(
    made: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    """Clay and hands move in the .blend without the extension."""
    result = run(PLAYBACK, str(made[0] / "kindergarten.blend"))
    assert "frames 1 4 60 True" in result.stdout, result.stdout + result.stderr


def test_sheet_puts_panels_in_reading_order() -> None:
    """The first frame is at the top left and the last at the bottom right."""
    panels = [np.full((30, 40, 4), value, np.float32) for value in (0.1, 0.2, 0.3, 0.4)]
    sheet = demo_picture.pairs_sheet(panels)
    assert sheet.shape == (66, 86, 4)
    corners = sheet[[3, 3, -4, -4], [3, -4, 3, -4], 0]
    np.testing.assert_allclose(corners, (0.1, 0.2, 0.3, 0.4))
    assert sheet[0, 0, 0] > 0.9


@pytest.mark.parametrize("count", [1, 2, 4, 6])
def test_feature_sheet_has_the_last_on_top_and_a_full_row_below(count: int) -> None:
    """The last frame is large, and the others fill the row below it in order."""
    widths = demo_picture.feature_widths(count, 301)
    panels = [
        np.full((round(0.5 * width), width, 4), 0.1 * (index + 1), np.float32)
        for index, width in enumerate(widths)
    ]
    sheet = demo_picture.feature_sheet(panels)
    assert sheet.shape[1] == 301 + 4
    np.testing.assert_allclose(sheet[2:152, 2:303, 0], 0.1 * count)
    row = sheet[155, 2:303, 0] if count > 1 else np.array([])
    shown = row[row < 0.9].astype(float).round(5)
    assert list(dict.fromkeys(shown.tolist())) == [
        round(0.1 * (n + 1), 5) for n in range(count - 1)
    ]
    assert len(row) - len(shown) == 2 * max(0, count - 2)


@pytest.mark.parametrize("name", demo_scenes.SCENES)
def test_moments_are_in_order_and_within_the_animation(name: str) -> None:
    """The frames shown are distinct and in order, and exist in the shortest animation."""
    scene = demo_scenes.SCENES[name]
    moments = demo._moments(scene.moments, 78)
    assert moments == sorted(set(moments)) and moments[-1] <= 78
    assert set(demo._moments(scene.moments, 2)) <= {1, 2}
    assert scene.layout in ("pairs", "feature")


@pytest.mark.parametrize("name", demo_scenes.SCENES)
def test_every_scene_has_its_own_folder(name: str) -> None:
    """By default, scenes do not overwrite each other's files."""
    others = {demo.default_output(other) for other in demo_scenes.SCENES if other != name}
    assert demo.default_output(name) not in others


@pytest.mark.parametrize("options", [["--frames", "1"], ["--frames", "999"], ["--width", "2"]])
@pytest.mark.parametrize("name", ["kindergarten", "incline"])
def test_invalid_options_are_refused(
    options: list[str], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Invalid options return 2 and print the valid range."""
    assert demo.main(["--scene", name, *options]) == 2
    assert "must be" in capsys.readouterr().err


def test_unknown_scene_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """An unknown scene returns 2 and lists the scenes."""
    assert demo.main(["--scene", "moon"]) == 2
    message = capsys.readouterr().err
    assert all(name in message for name in ("moon", *demo_scenes.SCENES))


def test_incline_is_made(tmp_path: Path) -> None:
    """A scene with several clay objects and a large frame has files named after it."""
    words = ("--scene", "incline", "--frames", "2", "--width", "64", "--samples", "1")
    result = run(DEMO, *words, "--output", str(tmp_path))
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert (report["scene"], report["particles"], report["frames"]) == ("incline", 4 * 480, 2)
    for suffix in (".blend", ".stl", ".ply", ".glb", ".png"):
        assert (tmp_path / f"incline{suffix}").stat().st_size > 1000


def test_file_in_place_of_the_output_folder_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command returns 1 and names the folder."""
    (tmp_path / "taken").write_text("")
    assert demo.main(["--output", str(tmp_path / "taken")]) == 1
    assert "taken" in capsys.readouterr().err
