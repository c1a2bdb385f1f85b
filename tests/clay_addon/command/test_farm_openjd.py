# SPDX-License-Identifier: GPL-3.0-or-later
"""The Open Job Description template, run for real by the specification's own program."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import pytest

from tactile_clay.clay_addon.bake.bake import bake

# Stands for Blender's program: `blender --background FILE --command clay WORD ...`. Where a file
# `kill_at` lies beside it, the process is killed while it writes that frame.
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
    """A machine that runs steps of the template on shots in a folder."""

    def __init__(self, template: Path, folder: Path) -> None:
        self.template = template
        self.folder = folder
        self.program = folder / "blender"
        self.program.write_text(PROGRAM.format(python=sys.executable))
        self.program.chmod(0o755)

    def start(self, step: str, shot: str, *options: str) -> subprocess.Popen[str]:
        """Begin a step with those before it, told paths as another machine has them."""
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
    """Wait for a step, and return what it said."""
    said, _ = process.communicate(timeout=300)
    return f"{said}\nexit code {process.returncode}"


def frame_bytes(directory: Path) -> dict[str, bytes]:
    """The bytes of every baked frame, by file name."""
    return {path.name: path.read_bytes() for path in sorted(directory.glob("frame_*.npz"))}


@pytest.fixture
def farm(repository: Path, tmp_path: Path) -> Farm:
    """A machine with an empty folder."""
    return Farm(repository / "presets/farm/clay_bake_render.openjd.yaml", tmp_path)


def make_shot(studio: Any, folder: Path, name: str, *, height: float) -> Path:
    """Save a shot of a falling block, and return the folder of a bake of it done alone."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    studio.clay(location=(0.0, 0.0, height))
    studio.table()
    studio.camera()
    studio.scene.frame_end = 8
    studio.save(folder, f"{name}.blend")
    bake(bpy.context, directory=folder / f"{name} alone", device="cpu")
    return folder / f"{name} alone"


def test_shots_baked_at_once_are_as_if_baked_alone(studio: Any, farm: Farm, tmp_path: Path) -> None:
    """Bake two shots in two processes at the same time, each to the bytes it gives alone."""
    alone = {
        "first": make_shot(studio, tmp_path, "first", height=0.022),
        "second": make_shot(studio, tmp_path, "second", height=0.03),
    }
    running = {shot: farm.start("Bake", shot) for shot in alone}
    for shot, process in running.items():
        said = finish(process)
        assert "exit code 0" in said, said
        frames = frame_bytes(tmp_path / shot / "clay_cache")
        assert len(frames) == 8
        assert frames == frame_bytes(alone[shot])
    assert frame_bytes(alone["first"]) != frame_bytes(alone["second"])


def test_killed_worker_is_resumed_and_the_shot_rendered(
    studio: Any, farm: Farm, tmp_path: Path
) -> None:
    """Kill the bake while it writes a frame, run the job again, and get the shot as if nothing."""
    alone = make_shot(studio, tmp_path, "shot", height=0.022)
    (tmp_path / "kill_at").write_text("frame_000005")
    said = finish(farm.start("Render", "shot"))
    assert "exit code 1" in said, said
    assert f"exited with code: {-signal.SIGKILL}" in said
    assert sorted(frame_bytes(tmp_path / "shot/clay_cache")) == [
        f"frame_{number:06}.npz" for number in range(1, 5)
    ]
    assert not (tmp_path / "shot/frames").exists()

    said = finish(farm.start("Render", "shot"))
    assert "exit code 0" in said, said
    assert "Frames 1 to 8: 4 baked, 4 kept" in said
    assert said.count("4 frames rendered, 0 kept") == 2
    assert frame_bytes(tmp_path / "shot/clay_cache") == frame_bytes(alone)
    pictures = sorted(path.name for path in (tmp_path / "shot/frames").iterdir())
    assert pictures == [f"frame_{number:04}.png" for number in range(1, 9)]
