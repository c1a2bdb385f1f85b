# SPDX-License-Identifier: GPL-3.0-or-later
"""The job type for Flamenco, run in a JavaScript engine against a stand-in of Flamenco's API."""

import json
from pathlib import Path
from typing import Any

import dukpy
import pytest

from tactile_clay.clay_addon.command.line import COMMANDS
from tactile_clay.clay_addon.command.words import make_parser

# What Flamenco documents for its job compiler scripts, and no more. Two frames in a row are "1,2"
# in its chunks, three "1-3".
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
    """The job type's script."""
    return (repository / "presets/farm/clay_bake_render.flamenco.js").read_text("utf-8")


def compile_job(source: str, **changes: Any) -> dict[str, Any]:
    """The job that Flamenco would make of settings."""
    settings = SETTINGS | changes
    result: dict[str, Any] = json.loads(
        dukpy.evaljs([FLAMENCO, source, COMPILE], settings=settings)
    )
    return result


def clay_words(task: dict[str, Any]) -> Any:
    """The words that a task gives to ``-c clay``, as the command line understands them."""
    (command,) = task["commands"]
    parameters = command["parameters"]
    assert command["name"] == "blender-render"
    assert (parameters["exe"], parameters["exeArgs"]) == ("{blender}", "{blenderArgs}")
    assert (parameters["argsBefore"], parameters["blendfile"]) == ([], "/farm/shot.blend")
    assert parameters["args"][:2] == ["--command", "clay"]
    return make_parser("clay", names_file=False, commands=COMMANDS).parse_args(
        parameters["args"][2:]
    )


def test_bake_comes_first_and_the_film_last(source: str) -> None:
    """Bake, render chunks that wait for the bake, and make a film that waits for all of them."""
    job = compile_job(source)
    bake, *renders, film = job["tasks"]
    assert (bake["name"], bake["type"], bake["dependencies"]) == ("bake", "blender", [])
    assert len(renders) == 3
    assert all(task["dependencies"] == ["bake"] for task in renders)
    assert (film["type"], film["dependencies"]) == ("ffmpeg", [task["name"] for task in renders])
    assert job["settings"]["output_path"] == "/farm/out/shot/2026-01-02_030405"


def test_tasks_say_what_the_command_line_understands(source: str) -> None:
    """Bake into a cache, and render each frame once from it, in words of the command line."""
    bake, *renders, _ = compile_job(source)["tasks"]
    baked = clay_words(bake)
    folder = "/farm/out/shot/2026-01-02_030405"
    assert (baked.cache, baked.device, baked.resume) == (f"{folder}/clay_cache", "cpu", True)
    rendered = [clay_words(task) for task in renders]
    assert [words.frames for words in rendered] == [[1, 2, 3], [4, 5, 6], [7, 8, 20]]
    for words in rendered:
        assert (words.cache, words.resume) == (baked.cache, True)
        assert words.output == f"{folder}/frames/frame_####"


def test_film_is_made_of_the_pictures(source: str) -> None:
    """Tell FFmpeg the pictures, their rate and where the film goes."""
    film = compile_job(source)["tasks"][-1]["commands"][0]
    folder = "/farm/out/shot/2026-01-02_030405"
    assert film["name"] == "frames-to-video"
    assert film["parameters"]["inputGlob"] == f"{folder}/frames/frame_*.png"
    assert film["parameters"]["outputFile"] == f"{folder}/shot.mp4"
    assert film["parameters"]["fps"] == 24


def test_formats_that_do_not_fit_are_told(source: str) -> None:
    """Make no film of pictures that FFmpeg cannot read, and refuse to render films in chunks."""
    job = compile_job(source, format="OPEN_EXR")
    assert {task["type"] for task in job["tasks"]} == {"blender"}
    assert job["printed"] == ["No film: FFmpeg does not read OPEN_EXR"]
    with pytest.raises(dukpy.JSRuntimeError, match="output format is a film"):
        compile_job(source, format="FFMPEG")


def test_settings_are_of_the_documented_kinds(source: str) -> None:
    """Declare settings with the keys and values that Flamenco's API knows."""
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
