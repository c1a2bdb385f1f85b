# SPDX-License-Identifier: GPL-3.0-or-later
"""`deliver`: write a bake to files for other programs and for rendering."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict

from .blend_file import CommandError, absolute_path, open_scene, save_file
from .output import ProgressLine, output_text
from .parser import EXIT_DONE, Outcome


def deliver_command(arguments: argparse.Namespace) -> Outcome:
    """Write the delivery, and save the file if requested."""
    context, scene = open_scene(arguments)
    from ..deliver.delivery import DeliveryError, deliver
    from ..deliver.operators import delivery_text

    properties = scene.tactile_clay
    if arguments.cache is not None:
        properties.cache_directory = absolute_path(arguments.cache)
    output = absolute_path(arguments.output)
    start, end = arguments.frames or (None, None)
    line = ProgressLine(sys.stderr)
    try:
        with context.temp_override(scene=scene):
            result = deliver(
                context,
                kind=arguments.format or properties.delivery_kind,
                start=start,
                end=end,
                directory=output,
                points=arguments.points or properties.delivery_points,
                show=arguments.save,
                progress=line,
            )
    except DeliveryError as error:
        raise CommandError(str(error)) from error
    finally:
        line.end()
    assert result is not None
    if arguments.save:
        if output is not None:
            properties.delivery_directory = output
        save_file("delivery")
    return EXIT_DONE, output_text(
        arguments,
        asdict(result),
        f"{delivery_text(result)} ({result.particle_count:,} particles, up to "
        f"{result.vertex_count:,} vertices).\nOpen: {result.file}",
    )
