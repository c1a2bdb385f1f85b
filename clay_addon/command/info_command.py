# SPDX-License-Identifier: GPL-3.0-or-later
"""`info`: describe the contents of a file and its bake."""

from __future__ import annotations

import argparse

from .blend_file import absolute_path, open_scene
from .output import output_text
from .parser import EXIT_DONE, EXIT_STALE, Outcome


def info_command(arguments: argparse.Namespace) -> Outcome:
    """Describe the scene; the exit code is stale if its bake is unusable or incomplete."""
    context, scene = open_scene(arguments)
    from .status import scene_status, status_text

    with context.temp_override(scene=scene):
        table = scene_status(context, absolute_path(arguments.cache))
    bake = table["bake"]
    stale = bake["stale"] or bake["missing"] or bake["problem"]
    return EXIT_STALE if stale else EXIT_DONE, output_text(arguments, table, status_text(table))
