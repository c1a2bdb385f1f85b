# SPDX-License-Identifier: GPL-3.0-or-later
"""`render`: render baked frames."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict

from .blend_file import CommandError, absolute_path, open_scene
from .output import output_text
from .parser import EXIT_DONE, EXIT_STALE, Outcome


def render_command(arguments: argparse.Namespace) -> Outcome:
    """Render frames, all of which must be baked."""
    context, scene = open_scene(arguments)
    from ..deliver.render_frames import (
        FrameNotBakedError,
        RenderError,
        RenderProgress,
        render_frames,
    )

    def report(progress: RenderProgress) -> None:
        # Blender's own wording, which render farm schedulers parse.
        print(f"Saved: '{progress.path}'", file=sys.stderr, flush=True)

    if arguments.cache is not None:
        scene.tactile_clay.cache_directory = absolute_path(arguments.cache)
    frames = arguments.frames
    if frames is None:
        frames = list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    try:
        with context.temp_override(scene=scene):
            result = render_frames(
                context,
                frames,
                output=absolute_path(arguments.output),
                resume=arguments.resume,
                progress=report,
            )
    except FrameNotBakedError as error:
        raise CommandError(str(error), EXIT_STALE) from error
    except RenderError as error:
        raise CommandError(str(error)) from error
    return EXIT_DONE, output_text(
        arguments,
        asdict(result),
        f"{result.rendered} frames rendered, {result.kept} kept.\nImages: {result.files[0].parent}",
    )
