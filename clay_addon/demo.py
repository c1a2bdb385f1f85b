# SPDX-License-Identifier: GPL-3.0-or-later
"""The demonstration: simulate, pack, export and render the kindergarten or the wheel scene.

It leaves a .blend that plays with and without the extension, the last frame as STL, PLY and GLB, a
contact sheet of six moments, and a report with the figures.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import bpy
import numpy as np
from numpy.typing import NDArray

EXPORTS = (".stl", ".ply", ".glb")
"""Formats of the last frame."""
PANEL_GAP = 10
"""Width of the lines between the pictures of the contact sheet [pixels]."""
PANEL_GAP_COLOR = (0.96, 0.94, 0.90, 1.0)

# Seconds that each stage takes on two cores; the time left is told from these, corrected by how
# long the stages so far have taken.
_STAGE_SECONDS = {
    "Loading kernels": 8.0,
    "Building the scene": 6.0,
    "Simulating": 20.0,
    "Packing": 2.0,
    "Exporting": 3.0,
    "Rendering": 75.0,
}


SCENES = {
    "kindergarten": ("kindergarten", (0.05, 0.22, 0.35, 0.72, 0.93, 1.0)),
    "wheel": ("wheel_scene", (0.04, 0.22, 0.42, 0.62, 0.83, 1.0)),
}
"""Scenes by name: the module that builds it, and when a picture of it is taken, as shares of its
frames: in the first hands come, flatten and pinch, tear, push, press; in the second they come,
centre, open, and widen. The last picture shows what they leave."""


class DemoError(Exception):
    """The demonstration cannot go on; the message says why and what to do."""


@dataclass(frozen=True)
class _Options:
    scene: str
    output: Path
    frame_count: int
    width: int
    samples: int


def main(argv: Sequence[str]) -> int:
    """Make the demonstration.

    Args:
        argv: Command-line words; ``--help`` lists them.

    Returns:
        0 when everything was made, 1 when something failed, 2 when the words are wrong.
    """
    try:
        options = _parse(argv)
    except SystemExit as end:
        return int(end.code or 0)
    from .bake import BakeError
    from .cache import CacheError
    from .export import ExportError
    from .make_clay import ClayError
    from .pack import PackError
    from .simulation import SimulationError
    from .surface import SurfaceError

    log = options.output / "demo.log"
    try:
        options.output.mkdir(parents=True, exist_ok=True)
        with _chatter_into(log) as terminal:
            lines = _make(options, _Progress(terminal))
    except OSError as error:
        print(f"demo: {options.output} cannot be written to: {error}", file=sys.stderr)
        return 1
    except (
        DemoError, BakeError, CacheError, ClayError, ExportError, PackError, SimulationError,
        SurfaceError, RuntimeError,
    ) as error:  # fmt: skip
        print(f"demo: {error}\nWhat Blender and Warp said is in {log}.", file=sys.stderr)
        return 1
    print("\n".join(lines), flush=True)
    return 0


def _parse(argv: Sequence[str]) -> _Options:
    parser = argparse.ArgumentParser(
        prog="tactile-clay demo", description="Make and render a scene with clay and hands."
    )
    parser.add_argument("--scene", choices=sorted(SCENES), default="kindergarten")
    parser.add_argument("--output", type=Path, default=Path("build/demo"), help="where it goes")
    parser.add_argument("--frames", type=int, help="frames to simulate (default: all)")
    parser.add_argument("--width", type=int, default=600, help="width of one picture [pixels]")
    parser.add_argument("--samples", type=int, default=16, help="samples a pixel")
    words = parser.parse_args(list(argv))
    whole = _scene_module(words.scene).FRAME_COUNT
    frames = whole if words.frames is None else words.frames
    if not 2 <= frames <= whole:
        parser.error(f"--frames must be 2 to {whole}.")
    if words.width < 16 or words.samples < 1:
        parser.error("--width must be at least 16 and --samples at least 1.")
    return _Options(words.scene, words.output.absolute(), frames, words.width, words.samples)


def _scene_module(scene: str) -> Any:
    return importlib.import_module(f".{SCENES[scene][0]}", __package__)


def _make(options: _Options, progress: _Progress) -> list[str]:
    """Make everything, and return what to tell about it."""
    from . import register
    from .bake import BakeProgress, bake
    from .export import clay_surface, write_mesh
    from .pack import pack_bake
    from .simulation import solver_device

    began = time.perf_counter()
    # Reading the factory settings would switch the extension off inside Blender, wheels and all.
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    register()
    context = bpy.context
    progress.start("Loading kernels")
    device = solver_device(context)
    _load_kernels(device)

    progress.start("Building the scene")
    scene = context.scene
    module = _scene_module(options.scene)
    built = module.build(context)
    count = len(built.clay.data.points)
    if count != module.PARTICLE_COUNT:
        raise DemoError(f"The scene holds {count} particles instead of {module.PARTICLE_COUNT}.")
    scene.frame_end = options.frame_count
    scene.tactile_clay.cache_directory = "//cache"
    blend = options.output / f"{options.scene}.blend"
    _save(blend)

    progress.start("Simulating")
    times = [time.perf_counter()]

    def frame_done(report: BakeProgress) -> None:
        times.append(time.perf_counter())
        progress.advance(report.done / report.total, f"frame {report.done} of {report.total}")

    result = bake(context, device=device, replace_other=True, progress=frame_done)
    milliseconds = 1e3 * np.diff(times)[1:]

    progress.start("Packing")
    packed = pack_bake(scene)
    scene.frame_set(scene.frame_start)
    _save(blend)

    progress.start("Exporting")
    scene.frame_set(scene.frame_end)
    surface, _, volume = clay_surface(context, [built.clay])
    files = [blend]
    files += [
        write_mesh(surface, options.output / f"{options.scene}{suffix}") for suffix in EXPORTS
    ]

    progress.start("Rendering")
    sheet = options.output / f"{options.scene}.png"
    moments = _moments(options.scene, options.frame_count)
    _render_sheet(context, built.clay, moments, sheet, options, progress)
    files.append(sheet)

    report = {
        "scene": options.scene,
        "particles": count,
        "frames": result.end + 1 - result.start,
        "frames_per_second": scene.render.fps,
        "device": result.device,
        "settings": result.settings,
        "spacing_m": module.SPACING,
        "milliseconds_a_frame": {
            "median": _rounded(np.median(milliseconds)),
            "percentile_90": _rounded(np.percentile(milliseconds, 90)),
            "what": "wall time of a simulated frame: Blender's hands and colliders, solver, cache",
        },
        "volume_error": _rounded(result.volume_error, 6),
        "volume_error_of_exported_mesh": _rounded(surface.volume / volume - 1.0, 6),
        "largest_penetration_m": _rounded(result.max_penetration, 6),
        "neighbour_overflow": result.overflow,
        "quarantined": result.quarantined,
        "warnings": list(result.warnings),
        "packed_bytes": packed["bytes"],
        "pictures_at_frames": moments,
        "versions": _versions(),
        "total_seconds": _rounded(time.perf_counter() - began, 1),
    }
    path = options.output / "report.json"
    path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    files.append(path)
    progress.end()
    return [
        f"{count:,} particles, {report['frames']} frames on {result.device}: "
        f"{np.median(milliseconds):.0f} ms a frame; all in {report['total_seconds']:.0f} s.",
        *(f"  {file}" for file in files),
    ]


def _load_kernels(device: str) -> None:
    """Compile what the simulation needs, or load it, by a first step with a little clay."""
    import warp

    from ..solver import Material, Scene, Solver
    from ..solver.default_hand import default_hand_rig

    warp.config.quiet = True
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * 0.02
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    scene = Scene(spacing=0.005)
    scene.add_clay_mesh(corners, faces, Material())
    scene.add_plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    scene.add_mesh(corners + np.array([0.0, 0.0, 0.03]), faces)
    scene.add_hand(default_hand_rig(clay_spacing=0.005))
    Solver(scene, device=device).step(1.0 / 60.0)


def _save(path: Path) -> None:
    # A second run must not leave the first one's file as a .blend1.
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)


def _moments(scene: str, frame_count: int) -> list[int]:
    """Frames to show of a scene."""
    return [max(1, round(share * frame_count)) for share in SCENES[scene][1]]


# Contact sheet ---------------------------------------------------------------------------------


def _render_sheet(
    context: bpy.types.Context,
    clay: bpy.types.Object,
    moments: Sequence[int],
    path: Path,
    options: _Options,
    progress: _Progress,
) -> None:
    """Render moments with their exact surfaces, and put them side by side, two a row."""
    from .export import clay_surface
    from .look import surface_object

    scene = context.scene
    scene.cycles.samples = options.samples
    scene.cycles.device = "CPU"
    scene.render.resolution_x = options.width
    scene.render.resolution_y = round(options.width / 1.5)
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "PNG"
    scene.render.use_persistent_data = True
    # The .blend keeps the finer settings; these cost a minute less and show little of it.
    scene.cycles.max_bounces = 3
    clay.hide_render = True
    panels = []
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        for index, frame in enumerate(moments):
            share = index / len(moments)
            progress.advance(share, f"picture {index + 1} of {len(moments)}")
            scene.frame_set(frame)
            surface = clay_surface(context, [clay])[0]
            shown = surface_object(surface, "Shown clay")
            scene.collection.objects.link(shown)
            scene.render.filepath = str(Path(folder) / f"{frame}.png")
            bpy.ops.render.render(write_still=True)
            panels.append(_read_image(scene.render.filepath))
            bpy.data.objects.remove(shown)
    _write_image(_side_by_side(panels), path)


def _side_by_side(panels: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Put pictures of one size two a row, with thin lines between and around them."""
    height, width, _ = panels[0].shape
    rows = (len(panels) + 1) // 2
    gap = max(2, round(PANEL_GAP * width / 720))
    sheet = np.empty((rows * (height + gap) + gap, 2 * (width + gap) + gap, 4), np.float32)
    sheet[:] = PANEL_GAP_COLOR
    for index, panel in enumerate(panels):
        top = gap + (index // 2) * (height + gap)
        left = gap + (index % 2) * (width + gap)
        sheet[top : top + height, left : left + width] = panel
    return sheet


def _read_image(path: str) -> NDArray[np.float32]:
    """Read a picture, shape [height, width, 4], from the top."""
    image = bpy.data.images.load(path)
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]


def _write_image(pixels: NDArray[np.float32], path: Path) -> None:
    image = bpy.data.images.new("Contact sheet", pixels.shape[1], pixels.shape[0])
    image.pixels.foreach_set(np.ascontiguousarray(pixels[::-1]).ravel())
    temporary = path.with_name(f".{path.name}")
    image.filepath_raw, image.file_format = str(temporary), "PNG"
    image.save()
    bpy.data.images.remove(image)
    temporary.replace(path)


# Report and progress ---------------------------------------------------------------------------


def _rounded(value: Any, digits: int = 2) -> float | None:
    return None if value is None else round(float(value), digits)


def _versions() -> dict[str, str]:
    import warp

    from .preferences import ADDON_VERSION

    return {
        "tactile_clay": ADDON_VERSION,
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "warp": warp.__version__,
        "numpy": np.__version__,
    }


class _Progress:
    """A bar with the time left on a terminal, now and then a plain line elsewhere."""

    _WIDTH = 28

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._bar = stream.isatty()
        self._began = time.perf_counter()
        self._stage = ""
        self._before = 0.0
        self._told = -1

    def start(self, stage: str) -> None:
        """Go on to a stage of `_STAGE_SECONDS`."""
        self._before += _STAGE_SECONDS.get(self._stage, 0.0)
        self._stage = stage
        self._told = -1
        self.advance(0.0, "")

    def advance(self, share: float, detail: str) -> None:
        """Tell how far the stage is.

        Args:
            share: Part of it that is done, 0 to 1.
            detail: What is being done.
        """
        total = sum(_STAGE_SECONDS.values())
        done = self._before + share * _STAGE_SECONDS[self._stage]
        elapsed = time.perf_counter() - self._began
        # The plan counts for as much as a quarter of its own length of experience.
        weight = done / (done + 0.25 * total)
        pace = weight * elapsed / max(done, 1e-6) + (1.0 - weight) if done else 1.0
        seconds = (total - done) * pace
        left = f"{seconds:.0f} s left" if seconds < 90 else f"{seconds / 60:.0f} min left"
        text = ", ".join(part for part in (self._stage, detail, left) if part)
        if self._bar:
            filled = round(self._WIDTH * done / total)
            bar = "█" * filled + "░" * (self._WIDTH - filled)
            self._stream.write(f"\r{bar} {text}\033[K")
        elif int(4 * share) > self._told:
            self._told = int(4 * share)
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self) -> None:
        """Leave the bar's line."""
        if self._bar:
            self._stream.write("\r\033[K")
            self._stream.flush()


@contextlib.contextmanager
def _chatter_into(log: Path) -> Iterator[IO[str]]:
    """Send what libraries print to a file, and give a stream that still reaches the terminal."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    kept = os.dup(1), os.dup(2)
    with log.open("w", encoding="utf-8") as file, os.fdopen(os.dup(2), "w") as terminal:
        try:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            yield terminal
        finally:
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
            for number, copy in zip((1, 2), kept, strict=True):
                os.dup2(copy, number)
                os.close(copy)
