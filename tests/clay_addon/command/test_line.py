# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: its effects, output and exit codes."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import pytest
import trimesh

from tactile_clay.clay_addon.command import parser as command_parser
from tactile_clay.clay_addon.command.line import main, main_in_blender
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.model.collider import make_collider


@pytest.fixture
def blend(studio: Any, tmp_path: Path) -> Path:
    """A saved file with a block of clay above a table, not baked."""
    studio.falling_block(tmp_path, end=4)
    return tmp_path / "scene.blend"


def test_bake_then_info_then_resume(blend: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A file can be baked, inspected and resumed to a later frame."""
    assert main(["bake", str(blend), "--frames", "1-3"]) == 0
    captured = capfd.readouterr()
    assert captured.out.startswith("Frames 1 to 3: 3 baked, 0 kept")
    assert "frame 3, 3 of 3, 0 s left" in captured.err
    assert main(["info", str(blend)]) == 0
    captured = capfd.readouterr()
    assert "clay      Clay: 64 particles with 10 mm spacing, plasticine" in captured.out
    assert "collider  Table: plane, friction 0.5" in captured.out
    assert "bake      3 of 3 frames (1 to 3)" in captured.out
    assert main(["bake", str(blend), "--resume", "--json"]) == 0
    table = json.loads(capfd.readouterr().out)
    assert (table["baked"], table["kept"], table["end"]) == (1, 3, 4)
    assert table["particle_count"] == 64
    assert table["median_frame_milliseconds"] > 0


def test_cache_option_is_relative_to_the_shell(
    blend: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A relative cache folder is in the working directory, and stored only with --save."""
    (elsewhere := tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(elsewhere)
    assert main(["bake", str(blend), "--cache", "here", "--frames", "1-2"]) == 0
    assert Cache(elsewhere / "here").frames() == [1, 2]
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    assert bpy.context.scene.tactile_clay.cache_directory == "//clay_cache"
    assert main(["bake", str(blend), "--cache", "here", "--frames", "1-2", "--save"]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    properties = bpy.context.scene.tactile_clay
    assert Path(bpy.path.abspath(properties.cache_directory)) == elsewhere / "here"
    assert (properties.use_scene_range, properties.frame_end) == (False, 2)


def test_export_writes_the_requested_frame(
    blend: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The baked shape at a frame is written in meters or millimeters, and described."""
    assert main(["bake", str(blend)]) == 0
    lowest = []
    for frame, unit, scale in ((1, "m", 1.0), (4, "mm", 1000.0)):
        path = tmp_path / f"shape-{frame}.stl"
        capfd.readouterr()
        options = ["--frame", str(frame), "--output", str(path), "--unit", unit, "--json"]
        assert main(["export", str(blend), *options]) == 0
        table = json.loads(capfd.readouterr().out)
        assert (table["frame"], table["watertight"]) == (frame, True)
        mesh = trimesh.load(path)
        assert isinstance(mesh, trimesh.Trimesh)
        assert mesh.volume == pytest.approx(64e-6 * scale**3, rel=0.01)
        lowest.append(mesh.bounds[0][2] / scale)
    assert lowest[0] == pytest.approx(0.01, abs=2e-3)
    assert lowest[1] == pytest.approx(0.0, abs=2.5e-3)


def test_deliver_writes_and_describes_files(
    blend: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The bake is written beside the .blend, which plays the files only with --save."""
    assert main(["bake", str(blend)]) == 0
    capfd.readouterr()
    assert main(["deliver", str(blend), "--frames", "1-3", "--json"]) == 0
    captured = capfd.readouterr()
    table = json.loads(captured.out)
    assert (table["start"], table["end"], table["shapes"], table["object_name"]) == (1, 3, 3, "")
    assert table["bytes"] > 3 * table["bytes_per_shape"] * 0.9 > 0
    assert table["seconds_per_shape"] > 0
    assert Path(table["file"]) == tmp_path / "clay_delivery" / "clay.usda"
    assert "frame 3, 3 of 3" in captured.err
    output = tmp_path / "alembic"
    options = ["--format", "abc", "--output", str(output), "--save"]
    assert main(["deliver", str(blend), *options]) == 0
    assert "Frames 1 to 4, 4 shapes: " in capfd.readouterr().out
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    (cache_file,) = bpy.data.cache_files
    assert cache_file.filepath == "//alembic/frames/clay_000001.abc"
    assert main(["deliver", str(blend), "--output", str(tmp_path)]) == 1
    assert "files that are not part of a delivery" in capfd.readouterr().err


def test_export_of_a_damaged_frame_is_refused(
    blend: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A damaged frame is not replaced by the shape of another one."""
    assert main(["bake", str(blend)]) == 0
    Cache(tmp_path / "clay_cache").frame_path(3).write_bytes(b"")
    output = tmp_path / "shape.stl"
    assert main(["export", str(blend), "--frame", "3", "--output", str(output)]) == 3
    assert "Frame 3: frame_000003.npz is damaged" in capfd.readouterr().err
    assert not output.exists()
    assert main(["export", str(blend), "--output", str(tmp_path / "shape.doc")]) == 1
    assert "Use one of .stl, .3mf, .obj, .ply, .glb" in capfd.readouterr().err


def test_keyed_pose_is_exported_without_a_bake(
    blend: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A keyed pose needs no bake, so there is no warning."""
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    bpy.ops.clay.pose_key()
    bpy.ops.wm.save_mainfile()
    capfd.readouterr()
    assert main(["export", str(blend), "--output", str(tmp_path / "pose.3mf")]) == 0
    captured = capfd.readouterr()
    assert "watertight" in captured.out
    assert "warning" not in captured.err


def test_export_of_a_frame_that_is_not_baked_warns(
    blend: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The warning names the frame written in place of one outside the bake."""
    options = ["--output", str(tmp_path / "shape.stl"), "--json"]
    assert main(["export", str(blend), *options]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["shown_frame"] is None
    assert "warning: nothing is baked; exported the clay without simulation" in captured.err
    assert main(["bake", str(blend)]) == 0
    capfd.readouterr()
    assert main(["export", str(blend), *options, "--frame", "500"]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["shown_frame"] == 4
    assert "warning: frame 500 is not baked; exported frame 4" in captured.err
    assert main(["export", str(blend), *options, "--cache", str(tmp_path / "none")]) == 1
    assert f"There is no bake in {tmp_path / 'none'}" in capfd.readouterr().err


def test_scene_option_bakes_another_scene(studio: Any, tmp_path: Path) -> None:
    """The named scene is baked, with its own clay and colliders, not the active one."""
    studio.falling_block(tmp_path)
    first = studio.scene
    bpy.ops.scene.new(type="EMPTY")
    studio.scene.name = "Other"
    studio.clay("Lump", size=0.02)
    tool = make_collider(studio.block(size=0.02, location=(0.5, 0.0, 0.0)))
    for frame in (1, 3):
        tool.location.x = 0.5 * frame
        tool.keyframe_insert("location", frame=frame)
    bpy.context.window.scene = first
    path = studio.save(tmp_path)
    options = ["--scene", "Other", "--cache", str(tmp_path / "other"), "--frames", "1-3"]
    assert main(["bake", str(path), *options]) == 0
    meta = Cache(tmp_path / "other").meta()
    assert [(part.name, part.count) for part in meta.clay] == [("Lump", 8)]
    frames = Cache(tmp_path / "other").intact_frames(1, 3)
    assert len({frame.inputs for frame in frames.values()}) == 3


def test_info_of_an_unbaked_file(blend: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Clay, material and colliders are listed, with no baked frames."""
    assert main(["info", str(blend), "--json"]) == 0
    table = json.loads(capfd.readouterr().out)
    (clay,) = table["clay"]
    assert (clay["name"], clay["particle_count"]) == ("Clay", 64)
    assert clay["spacing"] == pytest.approx(0.01)
    assert clay["material"]["density"] == 1700.0
    assert table["colliders"] == [
        {"name": "Table", "friction": 0.5, "problem": "", "kind": "plane"}
    ]
    assert table["bake"]["frames"] == 0


def test_stale_bake_has_its_own_exit_code(
    studio: Any, blend: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Resume and info return 3 if the scene has changed since the bake."""
    assert main(["bake", str(blend)]) == 0
    studio.scene.objects["Clay"].tactile_clay.density = 999.0
    bpy.ops.wm.save_mainfile()
    capfd.readouterr()
    assert main(["bake", str(blend), "--resume"]) == 3
    assert "the scene has changed: materials" in capfd.readouterr().err
    assert main(["info", str(blend)]) == 3
    assert "stale     the scene has changed: materials" in capfd.readouterr().out


def test_incomplete_bake_has_its_own_exit_code(
    blend: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Info returns 3 if a frame is missing or damaged, and names it."""
    assert main(["bake", str(blend)]) == 0
    Cache(tmp_path / "clay_cache").frame_path(3).write_bytes(b"")
    capfd.readouterr()
    assert main(["info", str(blend), "--json"]) == 3
    assert json.loads(capfd.readouterr().out)["bake"]["missing"] == [3]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "required: COMMAND"),
        (["fire"], "invalid choice: 'fire'"),
        (["bake"], "required: FILE.blend"),
        (["bake", "FILE", "--frames", "5"], "not a range such as 1-120"),
        (["bake", "FILE", "--frames", "9-5"], "ends before it starts"),
        (["bake", "FILE", "--device", "toaster"], "invalid choice: 'toaster'"),
        (["bake", "nowhere.blend"], "nowhere.blend does not exist"),
        (["info", "FILE", "--scene", "Stage"], "no scene 'Stage'. The scenes are: Scene"),
        (["export", "FILE"], "required: --output"),
        (["demo", "--scene", "moon"], "invalid choice: 'moon'"),
    ],
)
def test_wrong_usage_is_explained(
    blend: Path, capfd: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    """Invalid commands return 2 and print what is wrong."""
    assert main([str(blend) if word == "FILE" else word for word in arguments]) == 2
    assert words in capfd.readouterr().err


def test_invalid_blend_is_refused(
    studio: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A file that Blender cannot open returns 2."""
    (tmp_path / "bad.blend").write_text("not a blend")
    assert main(["info", str(tmp_path / "bad.blend")]) == 2
    assert "cannot be opened" in capfd.readouterr().err


def test_bake_that_cannot_start_says_why(
    studio: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A bake without clay returns 1 and prints the reason."""
    studio.block()
    path = studio.save(tmp_path)
    assert main(["bake", str(path)]) == 1
    assert "There is no clay in the scene" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("text", "expected"), [("1-120", (1, 120)), ("-5-3", (-5, 3)), ("-9--2", (-9, -2))]
)
def test_frame_ranges_may_be_negative(text: str, expected: tuple[int, int]) -> None:
    """Both frame numbers may have a sign."""
    assert command_parser.frame_range(text) == expected


def test_help_lists_the_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    """Help returns 0 and lists commands, options and exit codes."""
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("bake", "export", "info", "demo", "exit codes:"))
    assert main(["bake", "--help"]) == 0
    text = capsys.readouterr().out
    assert "tactile-clay bake" in text
    assert "--resume" in text
    assert "3    the bake is stale" in text


def test_command_inside_blender_takes_the_open_file(
    blend: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Inside Blender, commands apply to the open file."""
    assert main_in_blender(["bake", "--frames", "1-2"]) == 0
    assert Cache(tmp_path / "clay_cache").frames() == [1, 2]
    capfd.readouterr()
    assert main_in_blender(["info", "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["file"] == str(blend)


def test_installed_command_ends_with_its_exit_code(blend: Path) -> None:
    """The console entry point ends its process and prints only JSON to standard output."""
    entry = [sys.executable, "-c", "from tactile_clay.clay_addon.command.line import run; run()"]
    result = subprocess.run(
        [*entry, "bake", str(blend), "--json"], capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["baked"] == 4
    result = subprocess.run([*entry, "info", "x.blend"], capture_output=True, text=True, timeout=60)
    assert (result.returncode, result.stdout) == (2, "")


def test_missing_bpy_is_explained() -> None:
    """Without the bpy module, commands return 1 and name the package."""
    source = (
        "import sys; sys.modules['bpy'] = None\n"
        "from tactile_clay.clay_addon.command.line import main\n"
        "sys.exit(main(['info', 'scene.blend']))"
    )
    result = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True)
    assert result.returncode == 1
    assert "The bpy module is missing" in result.stderr


def test_closed_output_is_not_an_error(blend: Path) -> None:
    """The command ends quietly if its output is closed, as by `head`."""
    code = (
        "import sys; from tactile_clay.clay_addon.command.line import run\n"
        f"sys.argv = ['tactile-clay', 'info', {str(blend)!r}]; run()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.close()
        captured = process.stderr.read()
    assert process.returncode == 0
    assert b"Traceback" not in captured
