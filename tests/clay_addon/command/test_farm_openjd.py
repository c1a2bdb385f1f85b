# SPDX-License-Identifier: GPL-3.0-or-later
"""The Open Job Description template, run by openjd-cli, the specification's own program."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import pytest

from tactile_clay.clay_addon.bake.bake import bake

# A substitute for `blender --background FILE --command clay COMMAND ...`. If there is a file
# `kill_at` beside it, the process is killed while it writes the frame named there.
PROGRAM = """#!{python}
import os, signal, sys
from pathlib import Path
from tactile_clay.clay_addon.command import line as command_line

background, scene, command, clay, word, *rest = sys.argv[1:]
assert (background, command, clay) == ("--background", "--command", "clay")
kill_at = Path(__file__).with_name("kill_at")
if kill_at.exists():
    fsync, name = os.fsync, kill_at.read_text()
    kill_at.unlink()

    def fsync_or_die(handle):
        if name in os.readlink(f"/proc/self/fd/{{handle}}"):
            os.kill(os.getpid(), signal.SIGKILL)
        fsync(handle)

    os.fsync = fsync_or_die
sys.argv[1:] = [word, scene, *rest]
command_line.run()
"""
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the program is a script")


class Farm:
    """Runs steps of the template on shots in a folder."""

    def __init__(self, template: Path, folder: Path) -> None:
        self.template = template
        self.folder = folder
        self.program = folder / "blender"
        self.program.write_text(PROGRAM.format(python=sys.executable))
        self.program.chmod(0o755)

    def start(self, step: str, shot: str, *options: str) -> subprocess.Popen[str]:
        """Start a step and its dependencies, with paths mapped from another machine."""
        rule = {
            "source_path_format": "POSIX",
            "source_path": "/projects",
            "destination_path": str(self.folder),
        }
        rules = {"version": "pathmapping-1.0", "path_mapping_rules": [rule]}
        parameters = {
            "SceneFile": f"/projects/{shot}.blend",
            "OutputFolder": f"/projects/{shot}",
            "Frames": "1-8",
            "ChunkSize": 4,
            "Blender": str(self.program),
            "Device": "cpu",
        }
        return subprocess.Popen(
            [
                *(sys.executable, "-m", "openjd", "run", str(self.template)),
                *("--step", step, "--run-dependencies"),
                *("--job-param", json.dumps(parameters)),
                *("--path-mapping-rules", json.dumps(rules)),
                *options,
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )


def finish(process: subprocess.Popen[str]) -> str:
    """Wait for a step, and return its output and exit code."""
    output, _ = process.communicate(timeout=300)
    return f"{output}\nexit code {process.returncode}"


def frame_bytes(directory: Path) -> dict[str, bytes]:
    """Contents of all baked frames by file name."""
    return {path.name: path.read_bytes() for path in sorted(directory.glob("frame_*.npz"))}


@pytest.fixture
def farm(repository: Path, tmp_path: Path) -> Farm:
    """A farm with an empty folder."""
    return Farm(repository / "presets/farm/clay_bake_render.openjd.yaml", tmp_path)


def make_shot(studio: Any, folder: Path, name: str, *, height: float) -> Path:
    """Save a shot of a falling block, bake it on its own, and return the cache folder."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    studio.clay(location=(0.0, 0.0, height))
    studio.table()
    studio.camera()
    studio.scene.frame_end = 8
    studio.save(folder, f"{name}.blend")
    bake(bpy.context, directory=folder / f"{name} alone", device="cpu")
    return folder / f"{name} alone"


def test_shots_can_be_baked_in_parallel(studio: Any, farm: Farm, tmp_path: Path) -> None:
    """Two shots baked at the same time have the same bytes as when baked one at a time."""
    alone = {
        "first": make_shot(studio, tmp_path, "first", height=0.022),
        "second": make_shot(studio, tmp_path, "second", height=0.03),
    }
    running = {shot: farm.start("Bake", shot) for shot in alone}
    for shot, process in running.items():
        output = finish(process)
        assert "exit code 0" in output, output
        frames = frame_bytes(tmp_path / shot / "clay_cache")
        assert len(frames) == 8
        assert frames == frame_bytes(alone[shot])
    assert frame_bytes(alone["first"]) != frame_bytes(alone["second"])


def test_killed_worker_is_resumed_and_the_shot_rendered(
    studio: Any, farm: Farm, tmp_path: Path
) -> None:
    """A bake killed while it writes a frame, and resumed, has the bytes of an uninterrupted one."""
    alone = make_shot(studio, tmp_path, "shot", height=0.022)
    (tmp_path / "kill_at").write_text("frame_000005")
    output = finish(farm.start("Render", "shot"))
    assert "exit code 1" in output, output
    assert f"exited with code: {-signal.SIGKILL}" in output
    assert sorted(frame_bytes(tmp_path / "shot/clay_cache")) == [
        f"frame_{number:06}.npz" for number in range(1, 5)
    ]
    assert not (tmp_path / "shot/frames").exists()

    output = finish(farm.start("Render", "shot"))
    assert "exit code 0" in output, output
    assert "Frames 1 to 8: 4 baked, 4 kept" in output
    assert output.count("4 frames rendered, 0 kept") == 2
    assert frame_bytes(tmp_path / "shot/clay_cache") == frame_bytes(alone)
    pictures = sorted(path.name for path in (tmp_path / "shot/frames").iterdir())
    assert pictures == [f"frame_{number:04}.png" for number in range(1, 9)]
