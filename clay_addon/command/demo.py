# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: simulate, pack, export and render a scene of the gallery.

It writes a .blend that plays with and without the extension, the last frame as STL, PLY and GLB, an
image of several frames, and a report with statistics.
"""

from __future__ import annotations

import argparse
import importlib
import json
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...solver.core.errors import TactileClayError
from ..core.storage.atomic_files import replace_text
from .demo_progress import DemoProgress, redirected_output
from .demo_scenes import DEFAULT, SCENES, DemoScene

EXPORTS = (".stl", ".ply", ".glb")
"""Export formats of the last frame."""


class DemoError(TactileClayError):
    """The demo cannot continue; the message says why and what to do."""


@dataclass(frozen=True)
class _Options:
    name: str
    scene: DemoScene
    output: Path
    frame_count: int
    width: int
    samples: int


def main(argv: Sequence[str]) -> int:
    """Run the demo.

    Args:
        argv: Command-line arguments; see ``--help``.

    Returns:
        The exit code: 0 done, 1 failed, 2 usage.
    """
    try:
        options = _parse(argv)
    except SystemExit as end:
        return int(end.code or 0)
    from ..bake.bake import BakeError
    from ..clay.meshes import ClayError
    from ..core.storage.cache import CacheError
    from ..core.surface.exact import SurfaceError
    from ..deliver.export import ExportError
    from ..model.clay_scene import SimulationError
    from ..playback.pack import PackError

    log = options.output / "demo.log"
    try:
        options.output.mkdir(parents=True, exist_ok=True)
        with redirected_output(log) as terminal:
            lines = _make(options, DemoProgress(terminal, _stages(options.scene)))
    except OSError as error:
        print(f"demo: {options.output} cannot be written to: {error}", file=sys.stderr)
        return 1
    except (
        DemoError, BakeError, CacheError, ClayError, ExportError, PackError, SimulationError,
        SurfaceError, RuntimeError,
    ) as error:  # fmt: skip
        print(f"demo: {error}\nThe output of Blender and Warp is in {log}.", file=sys.stderr)
        return 1
    print("\n".join(lines), flush=True)
    return 0


def default_output(name: str) -> Path:
    """Default output folder of a scene."""
    return Path("build") / ("demo" if name == DEFAULT else f"demo-{name}")


def _parse(argv: Sequence[str]) -> _Options:
    parser = argparse.ArgumentParser(
        prog="tactile-clay demo", description="Simulate and render a scene of the gallery."
    )
    parser.add_argument("--scene", choices=list(SCENES), default=DEFAULT, help="the scene")
    parser.add_argument("--output", type=Path, help="the output folder")
    parser.add_argument("--frames", type=int, help="number of frames to simulate")
    parser.add_argument("--width", type=int, help="width of an image [pixels]")
    parser.add_argument("--samples", type=int, help="samples per pixel")
    arguments = parser.parse_args(list(argv))
    scene = SCENES[arguments.scene]
    max_frames = importlib.import_module(f"..scenes.{scene.module}", __package__).FRAME_COUNT
    frames = max_frames if arguments.frames is None else arguments.frames
    width = scene.width if arguments.width is None else arguments.width
    samples = scene.samples if arguments.samples is None else arguments.samples
    if not 2 <= frames <= max_frames:
        parser.error(f"--frames must be 2 to {max_frames}.")
    if width < 16 or samples < 1:
        parser.error("--width must be at least 16 and --samples at least 1.")
    output = arguments.output or default_output(arguments.scene)
    return _Options(arguments.scene, scene, output.absolute(), frames, width, samples)


def _stages(scene: DemoScene) -> dict[str, float]:
    """Durations of the stages on two cores [s]."""
    return {
        "Loading kernels": 8.0,
        "Building the scene": 6.0,
        "Simulating": scene.simulation_seconds,
        "Packing": 2.0,
        "Exporting": 3.0,
        "Rendering": scene.render_seconds,
    }


def _make(options: _Options, progress: DemoProgress) -> list[str]:
    """Run all stages, and return the lines of a summary."""
    from .. import register
    from ..bake.bake import BakeProgress, bake
    from ..deliver.export import clay_surface, write_mesh
    from ..model.clay_scene import clay_objects, solver_device
    from ..playback.pack import pack_bake

    began = time.perf_counter()
    # Inside Blender, reading the factory settings would disable the extension and its wheels.
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    register()
    context = bpy.context
    progress.start("Loading kernels")
    device = solver_device(context)
    _load_kernels(device)

    progress.start("Building the scene")
    scene = context.scene
    importlib.import_module(f"..scenes.{options.scene.module}", __package__).build(context)
    clays = clay_objects(scene)
    count = sum(len(clay.data.points) for clay in clays)
    scene.frame_end = options.frame_count
    scene.tactile_clay.cache_directory = "//cache"
    blend = options.output / f"{options.name}.blend"
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
    surface, _, volume = clay_surface(context, clays)
    files = [blend]
    files += [write_mesh(surface, options.output / f"{options.name}{suffix}") for suffix in EXPORTS]

    progress.start("Rendering")
    moments = _moments(options.scene.moments, options.frame_count)
    files.append(_render(context, moments, options, progress))

    report = {
        "scene": options.name,
        "particles": count,
        "frames": result.end + 1 - result.start,
        "frames_per_second": scene.render.fps,
        "device": result.device,
        "settings": result.settings,
        "spacing_m": _rounded(clays[0].tactile_clay.spacing, 6),
        "milliseconds_a_frame": {
            "median": _rounded(np.median(milliseconds)),
            "percentile_90": _rounded(np.percentile(milliseconds, 90)),
            "what": "wall time per simulated frame: Blender's hands and colliders, solver, cache",
        },
        "volume_error": _rounded(result.volume_error, 6),
        "volume_error_of_exported_mesh": _rounded(surface.volume / volume - 1.0, 6),
        "largest_penetration_m": _rounded(result.max_penetration, 6),
        "neighbor_overflow": result.overflow,
        "quarantined": result.quarantined,
        "warnings": list(result.warnings),
        "packed_bytes": packed["bytes"],
        "pictures_at_frames": moments,
        "versions": _versions(),
        "total_seconds": _rounded(time.perf_counter() - began, 1),
    }
    path = options.output / "report.json"
    replace_text(path, json.dumps(report, indent=2) + "\n")
    files.append(path)
    progress.end()
    return [
        f"{count:,} particles, {report['frames']} frames on {result.device}: "
        f"{np.median(milliseconds):.0f} ms per frame; {report['total_seconds']:.0f} s in total.",
        *(f"  {file}" for file in files),
    ]


def _load_kernels(device: str) -> None:
    """Compile or load the kernels of the simulation with one step of a small scene."""
    import warp

    from ...solver import Material, Scene, Solver
    from ...solver.hand.default_hand import default_hand_rig

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
    # Do not keep the file of an earlier run as a .blend1.
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)


def _moments(fractions: Sequence[float], frame_count: int) -> list[int]:
    """Frames to show, at fractions of the animation."""
    return [max(1, round(fraction * frame_count)) for fraction in fractions]


def _render(
    context: bpy.types.Context, moments: Sequence[int], options: _Options, progress: DemoProgress
) -> Path:
    """Render frames to one sheet, and return its file."""
    from .demo_picture import (
        feature_sheet,
        feature_widths,
        pairs_sheet,
        render_moments,
        write_picture,
    )

    feature = options.scene.layout == "feature"
    widths = (
        feature_widths(len(moments), options.width) if feature else [options.width] * len(moments)
    )
    panels = render_moments(
        context, moments, widths, options.samples, options.output, progress.advance
    )
    path = options.output / f"{options.name}.png"
    write_picture((feature_sheet if feature else pairs_sheet)(panels), path)
    return path


# Report --------------------------------------------------------------------------------------


def _rounded(value: Any, digits: int = 2) -> float | None:
    return None if value is None else round(float(value), digits)


def _versions() -> dict[str, str]:
    import warp

    from ..base.preferences import ADDON_VERSION

    return {
        "tactile_clay": ADDON_VERSION,
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "warp": warp.__version__,
        "numpy": np.__version__,
    }
