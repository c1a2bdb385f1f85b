# SPDX-License-Identifier: GPL-3.0-or-later
"""`export`: write the clay at one frame to a mesh file."""

from __future__ import annotations

import argparse
import sys

from .blend_file import CommandError, absolute_path, open_scene
from .output import output_text
from .parser import EXIT_DONE, EXIT_STALE, Outcome


def export_command(arguments: argparse.Namespace) -> Outcome:
    """Write the mesh file."""
    context, scene = open_scene(arguments)
    from ..core.surface.exact import SurfaceError
    from ..deliver.export import ExportError, check_target, export_clay
    from ..model.clay_scene import clay_objects
    from ..playback.playback import message, shown_frame
    from ..playback.poses import needs_no_cache

    if arguments.cache is not None:
        scene.tactile_clay.cache_directory = absolute_path(arguments.cache)
    frame = scene.frame_current if arguments.frame is None else arguments.frame
    try:
        check_target(arguments.output, unit=arguments.unit)
        with context.temp_override(scene=scene):
            scene.frame_set(frame)
            itself = all(
                needs_no_cache(item, scene.frame_current_final) for item in clay_objects(scene)
            )
            if message(scene) and not itself:
                raise CommandError(message(scene), EXIT_STALE)
            shown = frame if itself else shown_frame(scene)
            if shown is None and arguments.cache is not None:
                raise CommandError(f"There is no bake in {absolute_path(arguments.cache)}.")
            table = export_clay(
                context,
                arguments.output.absolute(),
                unit=arguments.unit,
                base=arguments.base,
                wall=arguments.wall,
            )
    except (ExportError, SurfaceError) as error:
        raise CommandError(str(error)) from error
    if shown is None:
        print("warning: nothing is baked; exported the clay without simulation", file=sys.stderr)
    elif shown != frame:
        print(f"warning: frame {frame} is not baked; exported frame {shown}", file=sys.stderr)
    for warning in (table["print"] or {}).get("warnings", ()):
        print(f"warning: {warning}", file=sys.stderr)
    # Adding zero avoids -0.00.
    volume_error = round(table["volume_error"], 4) + 0.0
    return EXIT_DONE, output_text(
        arguments,
        {"frame": frame, "shown_frame": shown, **table},
        f"Frame {frame} written to {table['file']}: {table['faces']:,} triangles, watertight, "
        f"volume {volume_error:+.2%} from that of the particles.",
    )
