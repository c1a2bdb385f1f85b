# SPDX-License-Identifier: GPL-3.0-or-later
"""The job type for Flamenco, run in a JavaScript engine with a mock of Flamenco's API."""

import json
from pathlib import Path
from typing import Any

import dukpy
import pytest

from tactile_clay.clay_addon.command.line import COMMANDS
from tactile_clay.clay_addon.command.parser import make_parser

# Only the documented API for job compiler scripts. In its chunks, two consecutive frames are "1,2",
# three are "1-3".
FLAMENCO = """
var printed = [];
function print() { printed.push([].slice.call(arguments).join(" ")); }
function formatTimestampLocal(time) { return time; }
var path = {
    join: function () { return [].slice.call(arguments).join("/"); },
    basename: function (p) { return p.split("/").pop(); },
    dirname: function (p) { return p.split("/").slice(0, -1).join("/"); },
    stem: function (p) { return path.basename(p).replace(/\\.[^.]*$/, ""); }
};
function frameChunker(range, size) {
    var frames = [], chunks = [];
    range.split(",").forEach(function (part) {
        var ends = part.split("-").map(Number);
        for (var f = ends[0]; f <= ends[ends.length - 1]; f++) { frames.push(f); }
    });
    for (var i = 0; i < frames.length; i += size) {
        var parts = [], chunk = frames.slice(i, i + size);
        for (var from = 0, to; from < chunk.length; from = to + 1) {
            for (to = from; chunk[to + 1] === chunk[to] + 1; to++) {}
            parts.push(to - from > 1 ? chunk[from] + "-" + chunk[to]
                                     : chunk.slice(from, to + 1).join(","));
        }
        chunks.push(parts.join(","));
    }
    return chunks;
}
var author = {
    Task: function (name, type) {
        var task = { name: name, type: type, commands: [], dependencies: [] };
        task.addCommand = function (command) { task.commands.push(command); };
        task.addDependency = function (other) { task.dependencies.push(other.name); };
        return task;
    },
    Command: function (name, parameters) { return { name: name, parameters: parameters }; }
};
"""
COMPILE = """
var tasks = [];
var job = { settings: dukpy.settings, created: "2026-01-02_030405",
            addTask: function (task) { tasks.push(task); } };
compileJob(job);
JSON.stringify({ tasks: tasks, settings: job.settings, printed: printed });
"""
SETTINGS = {
    "frames": "1-8, 20",
    "chunk_size": 3,
    "device": "cpu",
    "output_path": "/farm/out/shot/{timestamp}",
    "blendfile": "/farm/shot.blend",
    "fps": 24,
    "format": "PNG",
    "image_file_extension": ".png",
}


@pytest.fixture(scope="module")
def source(repository: Path) -> str:
    """The script of the job type."""
    return (repository / "presets/farm/clay_bake_render.flamenco.js").read_text("utf-8")


def compile_job(source: str, **changes: Any) -> dict[str, Any]:
    """The job that Flamenco would create with the given settings."""
    settings = SETTINGS | changes
    result: dict[str, Any] = json.loads(
        dukpy.evaljs([FLAMENCO, source, COMPILE], settings=settings)
    )
    return result


def clay_arguments(task: dict[str, Any]) -> Any:
    """The arguments of a task's ``-c clay`` command, parsed."""
    (command,) = task["commands"]
    parameters = command["parameters"]
    assert command["name"] == "blender-render"
    assert (parameters["exe"], parameters["exeArgs"]) == ("{blender}", "{blenderArgs}")
    assert (parameters["argsBefore"], parameters["blendfile"]) == ([], "/farm/shot.blend")
    assert parameters["args"][:2] == ["--command", "clay"]
    return make_parser("clay", file_argument=False, commands=COMMANDS).parse_args(
        parameters["args"][2:]
    )


def test_bake_comes_first_and_the_video_last(source: str) -> None:
    """Chunks depend on the bake, and the video depends on all chunks."""
    job = compile_job(source)
    bake, *renders, video = job["tasks"]
    assert (bake["name"], bake["type"], bake["dependencies"]) == ("bake", "blender", [])
    assert len(renders) == 3
    assert all(task["dependencies"] == ["bake"] for task in renders)
    assert (video["type"], video["dependencies"]) == ("ffmpeg", [task["name"] for task in renders])
    assert job["settings"]["output_path"] == "/farm/out/shot/2026-01-02_030405"


def test_tasks_are_valid_commands(source: str) -> None:
    """The bake writes to a cache, from which each frame is rendered once."""
    bake, *renders, _ = compile_job(source)["tasks"]
    baked = clay_arguments(bake)
    folder = "/farm/out/shot/2026-01-02_030405"
    assert (baked.cache, baked.device, baked.resume) == (f"{folder}/clay_cache", "cpu", True)
    rendered = [clay_arguments(task) for task in renders]
    assert [each.frames for each in rendered] == [[1, 2, 3], [4, 5, 6], [7, 8, 20]]
    for each in rendered:
        assert (each.cache, each.resume) == (baked.cache, True)
        assert each.output == f"{folder}/frames/frame_####"


def test_video_is_made_from_the_images(source: str) -> None:
    """FFmpeg gets the images, their frame rate and the output file."""
    video = compile_job(source)["tasks"][-1]["commands"][0]
    folder = "/farm/out/shot/2026-01-02_030405"
    assert video["name"] == "frames-to-video"
    assert video["parameters"]["inputGlob"] == f"{folder}/frames/frame_*.png"
    assert video["parameters"]["outputFile"] == f"{folder}/shot.mp4"
    assert video["parameters"]["fps"] == 24


def test_unsuitable_formats_are_reported(source: str) -> None:
    """There is no video of images that FFmpeg cannot read; video formats are refused."""
    job = compile_job(source, format="OPEN_EXR")
    assert {task["type"] for task in job["tasks"]} == {"blender"}
    assert job["printed"] == ["No film: FFmpeg does not read OPEN_EXR"]
    with pytest.raises(dukpy.JSRuntimeError, match="output format is a film"):
        compile_job(source, format="FFMPEG")


def test_settings_follow_the_documentation(source: str) -> None:
    """Settings have only keys and values that Flamenco's API supports."""
    read = "JSON.stringify(JOB_TYPE)"
    job_type = json.loads(dukpy.evaljs([FLAMENCO, source, read]))
    known = {
        *("key", "type", "subtype", "choices", "propargs", "description", "label", "default"),
        *("eval", "evalInfo", "visible", "required", "editable"),
    }
    assert job_type["label"]
    keys = [setting["key"] for setting in job_type["settings"]]
    assert sorted({*SETTINGS, "output_root"}) == sorted(keys)
    for setting in job_type["settings"]:
        assert set(setting) <= known
        assert setting["type"] in {"string", "int32", "float", "bool"}
        assert setting.get("visible", "visible") in {"visible", "hidden", "submission", "web"}
        if "eval" in setting:
            compile(setting["eval"], setting["key"], "eval")
