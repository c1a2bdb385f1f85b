# SPDX-License-Identifier: GPL-3.0-or-later
"""`bake`: bake the clay of a scene, or bake its take again."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from typing import Any

from .blend_file import CommandError, absolute_path, open_scene, save_file
from .output import ProgressLine, output_text
from .parser import EXIT_DONE, EXIT_STALE, EXIT_USAGE, Outcome


def bake_command(arguments: argparse.Namespace) -> Outcome:
    """Bake, and save the file if requested."""
    if not arguments.again and (arguments.spacing or arguments.substeps):
        raise CommandError("--spacing and --substeps require --again.", EXIT_USAGE)
    context, scene = open_scene(arguments)
    from ..bake.bake import BakeError, BakeStaleError, bake
    from ..core.storage.cache import CacheError

    if arguments.again:
        scene = _film(context, scene, arguments)
    start, end = arguments.frames or (None, None)
    line = ProgressLine(sys.stderr)
    try:
        with context.temp_override(scene=scene):
            result = bake(
                context,
                start=start,
                end=end,
                directory=absolute_path(arguments.cache),
                resume=arguments.resume,
                device=arguments.device,
                replace_other=arguments.replace,
                progress=line,
            )
    except BakeStaleError as error:
        raise CommandError(str(error), EXIT_STALE) from error
    except (BakeError, CacheError) as error:
        raise CommandError(str(error)) from error
    finally:
        line.end()
    if arguments.save or arguments.again:
        _save(scene, arguments)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    table = asdict(result)
    milliseconds = result.median_frame_milliseconds
    pace = f", {milliseconds:.0f} ms per frame" if milliseconds is not None else ""
    return EXIT_DONE, output_text(
        arguments,
        table,
        f"Frames {result.start} to {result.end}: {result.baked} baked, {result.kept} kept{pace} "
        f"({result.particle_count:,} particles on {result.device}).\nCache: {result.directory}",
    )


def _film(context: Any, scene: Any, arguments: argparse.Namespace) -> Any:
    """The scene for baking a take again, made or updated unless resuming."""
    import bpy

    from ..base.units import from_meters
    from ..take.film import FilmError, make_film

    source = scene.tactile_clay.film_of or scene
    existing = [each for each in bpy.data.scenes if each.tactile_clay.film_of == source]
    if arguments.resume and existing:
        film = existing[0]
    else:
        spacing = from_meters(scene, (arguments.spacing or 0.0) * 1e-3)
        try:
            film = make_film(context, spacing=spacing, substeps=arguments.substeps)
        except FilmError as error:
            raise CommandError(str(error)) from error
    if context.window is not None:
        context.window.scene = film
    return film


def _save(scene: Any, arguments: argparse.Namespace) -> None:
    properties = scene.tactile_clay
    if arguments.frames:
        properties.use_scene_range = False
        properties.frame_start, properties.frame_end = arguments.frames
    if arguments.cache is not None:
        properties.cache_directory = absolute_path(arguments.cache)
    save_file("bake")
