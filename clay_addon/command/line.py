# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: bake, render, deliver, export and look into .blend files, and track hands.

The same words serve ``tactile-clay bake FILE.blend`` (with the bpy module) and
``blender -b FILE.blend -c clay bake`` (inside Blender, on the file that is open).
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .output import ProgressLine, diverted_output, output_text
from .words import (
    EXIT_DONE,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_STALE,
    EXIT_USAGE,
    Outcome,
    make_parser,
)


class _CommandError(Exception):
    """The command cannot be carried out."""

    def __init__(self, message: str, exit_code: int = EXIT_FAILED) -> None:
        super().__init__(message)
        self.exit_code = exit_code


def main(argv: Sequence[str]) -> int:
    """Carry out a command on a .blend file that it names.

    Args:
        argv: The words after the program's name.

    Returns:
        The exit code: 0 done, 1 failed, 2 usage, 3 stale, 130 interrupted.
    """
    return _main(argv, program="tactile-clay", names_file=True)


def main_in_blender(argv: Sequence[str]) -> int:
    """Carry out a command on the file that is open in Blender; see `main`."""
    return _main(argv, program="blender -b FILE.blend -c clay", names_file=False)


def run() -> None:
    """Carry out the command that the shell gave, and end the process."""
    try:
        code = main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read the output has seen enough, as `head` does.
        code = 0
    sys.stderr.flush()
    # The bpy module of Blender 4.5 can hang while the interpreter is torn down.
    os._exit(code)


def _main(argv: Sequence[str], *, program: str, names_file: bool) -> int:
    parser = make_parser(program, names_file=names_file, commands=COMMANDS)
    try:
        arguments = parser.parse_args(list(argv))
    except SystemExit as end:
        return int(end.code or 0)
    try:
        # What Blender and Warp print belongs to the standard error: the standard output has the
        # result and nothing else.
        with contextlib.nullcontext() if _prints_itself(arguments) else diverted_output():
            code, result = arguments.carry_out(arguments)
        if result:
            print(result, flush=True)
        return code
    except _CommandError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"{program}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _prints_itself(arguments: argparse.Namespace) -> bool:
    """Whether a command says on its own what it does, while it does it."""
    return arguments.carry_out in (_demo, _array_server)


def _bake(arguments: argparse.Namespace) -> Outcome:
    if not arguments.again and (arguments.spacing or arguments.substeps):
        raise _CommandError("--spacing and --substeps go with --again.", EXIT_USAGE)
    context, scene = _open(arguments)
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
                directory=_absolute(arguments.cache),
                resume=arguments.resume,
                device=arguments.device,
                replace_other=arguments.replace,
                progress=line,
            )
    except BakeStaleError as error:
        raise _CommandError(str(error), EXIT_STALE) from error
    except (BakeError, CacheError) as error:
        raise _CommandError(str(error)) from error
    finally:
        line.end()
    if arguments.save or arguments.again:
        _save(scene, arguments)
    for warning in result.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    table = asdict(result)
    milliseconds = result.median_frame_milliseconds
    pace = f", {milliseconds:.0f} ms a frame" if milliseconds is not None else ""
    return EXIT_DONE, output_text(
        arguments,
        table,
        f"Frames {result.start} to {result.end}: {result.baked} baked, {result.kept} kept{pace} "
        f"({result.particle_count:,} particles on {result.device}).\nCache: {result.directory}",
    )


def _film(context: Any, scene: Any, arguments: argparse.Namespace) -> Any:
    """The scene in which a scene's take is baked again."""
    import bpy

    from ..take.film import FilmError, make_film

    source = scene.tactile_clay.film_of or scene
    known = [each for each in bpy.data.scenes if each.tactile_clay.film_of == source]
    if arguments.resume and known:
        film = known[0]
    else:
        scale = scene.unit_settings.scale_length
        spacing = (arguments.spacing or 0.0) * 1e-3 / scale
        try:
            film = make_film(context, spacing=spacing, substeps=arguments.substeps)
        except FilmError as error:
            raise _CommandError(str(error)) from error
    if context.window is not None:
        context.window.scene = film
    return film


def _export(arguments: argparse.Namespace) -> Outcome:
    context, scene = _open(arguments)
    from ..core.surface.exact import SurfaceError
    from ..deliver.export import ExportError, check_target, export_clay
    from ..model.clay_scene import clay_objects
    from ..playback.playback import message, shown_frame
    from ..playback.poses import plays_itself

    if arguments.cache is not None:
        scene.tactile_clay.cache_directory = _absolute(arguments.cache)
    frame = scene.frame_current if arguments.frame is None else arguments.frame
    try:
        check_target(arguments.output, unit=arguments.unit)
        with context.temp_override(scene=scene):
            scene.frame_set(frame)
            itself = all(plays_itself(item, frame) for item in clay_objects(scene))
            if message(scene) and not itself:
                raise _CommandError(message(scene), EXIT_STALE)
            shown = frame if itself else shown_frame(scene)
            if shown is None and arguments.cache is not None:
                raise _CommandError(f"There is no bake in {_absolute(arguments.cache)}.")
            table = export_clay(
                context,
                arguments.output.absolute(),
                unit=arguments.unit,
                base=arguments.base,
                wall=arguments.wall,
            )
    except (ExportError, SurfaceError) as error:
        raise _CommandError(str(error)) from error
    if shown is None:
        print("warning: nothing is baked, so this is the clay as it was made", file=sys.stderr)
    elif shown != frame:
        print(f"warning: frame {frame} is not baked, so this is frame {shown}", file=sys.stderr)
    for warning in (table["print"] or {}).get("warnings", ()):
        print(f"warning: {warning}", file=sys.stderr)
    # Adding zero keeps rounding from writing -0.00.
    volume_error = round(table["volume_error"], 4) + 0.0
    return EXIT_DONE, output_text(
        arguments,
        {"frame": frame, "shown_frame": shown, **table},
        f"Frame {frame} written to {table['file']}: {table['faces']:,} triangles, watertight, "
        f"volume {volume_error:+.2%} off the particles' own.",
    )


def _deliver(arguments: argparse.Namespace) -> Outcome:
    context, scene = _open(arguments)
    from ..deliver.delivery import DeliveryError, deliver
    from ..deliver.operators import describe

    properties = scene.tactile_clay
    if arguments.cache is not None:
        properties.cache_directory = _absolute(arguments.cache)
    output = _absolute(arguments.output)
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
        raise _CommandError(str(error)) from error
    finally:
        line.end()
    assert result is not None
    if arguments.save:
        if output is not None:
            properties.delivery_directory = output
        _save_file("delivery")
    return EXIT_DONE, output_text(
        arguments,
        asdict(result),
        f"{describe(result)} ({result.particle_count:,} particles, up to "
        f"{result.vertex_count:,} vertices).\nOpen: {result.file}",
    )


def _render(arguments: argparse.Namespace) -> Outcome:
    context, scene = _open(arguments)
    from ..deliver.render_frames import (
        FrameNotBakedError,
        RenderError,
        RenderProgress,
        render_frames,
    )

    def tell(progress: RenderProgress) -> None:
        # The words in which Blender itself tells it, from which schedulers read what there is.
        print(f"Saved: '{progress.path}'", file=sys.stderr, flush=True)

    if arguments.cache is not None:
        scene.tactile_clay.cache_directory = _absolute(arguments.cache)
    frames = arguments.frames
    if frames is None:
        frames = list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
    try:
        with context.temp_override(scene=scene):
            result = render_frames(
                context,
                frames,
                output=_absolute(arguments.output),
                resume=arguments.resume,
                progress=tell,
            )
    except FrameNotBakedError as error:
        raise _CommandError(str(error), EXIT_STALE) from error
    except RenderError as error:
        raise _CommandError(str(error)) from error
    return EXIT_DONE, output_text(
        arguments,
        asdict(result),
        f"{result.rendered} frames rendered, {result.kept} kept.\n"
        f"Pictures: {result.files[0].parent}",
    )


def _info(arguments: argparse.Namespace) -> Outcome:
    context, scene = _open(arguments)
    from .status import describe, inspect

    with context.temp_override(scene=scene):
        table = inspect(context, _absolute(arguments.cache))
    bake = table["bake"]
    unsound = bake["stale"] or bake["missing"] or bake["problem"]
    return EXIT_STALE if unsound else EXIT_DONE, output_text(arguments, table, describe(table))


def _array_server(arguments: argparse.Namespace) -> Outcome:
    from ...haptics.array_server.command import carry_out

    return carry_out(arguments), ""


def _demo(arguments: argparse.Namespace) -> Outcome:
    _need_bpy()
    from . import demo

    words = ["--scene", arguments.scene]
    if arguments.output is not None:
        words += ["--output", str(arguments.output)]
    return demo.main(words), ""


def _track(arguments: argparse.Namespace) -> Outcome:
    # A tracker's sender runs without Blender.
    from ..core.tracking import TrackingError
    from ..core.tracking.command import track

    try:
        return EXIT_DONE, track(arguments)
    except TrackingError as error:
        raise _CommandError(str(error)) from error


# What they share -------------------------------------------------------------------------------


def _need_bpy() -> Any:
    try:
        import bpy
    except ImportError as error:
        raise _CommandError(
            "The bpy module is missing. Install it into this Python (the package bpy: 5.2 for "
            "Python 3.13, 4.5 for Python 3.11), or run the command inside Blender: "
            "blender -b FILE.blend -c clay …"
        ) from error
    return bpy


def _open(arguments: argparse.Namespace) -> tuple[Any, Any]:
    """The context and the scene that a command is about, with the file open."""
    bpy = _need_bpy()
    if arguments.file is not None:
        path = arguments.file.absolute()
        if not path.is_file():
            raise _CommandError(f"There is no file {path}.", EXIT_USAGE)
        from .. import register

        register()
        try:
            bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
        except RuntimeError as error:
            raise _CommandError(f"{path} cannot be opened: {error}", EXIT_USAGE) from error
    context = bpy.context
    if arguments.scene is None:
        return context, context.scene
    scene = bpy.data.scenes.get(arguments.scene)
    if scene is None:
        known = ", ".join(each.name for each in bpy.data.scenes)
        raise _CommandError(
            f"There is no scene {arguments.scene!r}. There are: {known}.", EXIT_USAGE
        )
    if context.window is not None:
        context.window.scene = scene
    return context, scene


def _absolute(path: str | None) -> str | None:
    """A path given in the shell is relative to the shell; ``//`` to the .blend."""
    if path is None or path.startswith("//"):
        return path
    return str(Path(path).absolute())


def _save(scene: Any, arguments: argparse.Namespace) -> None:
    properties = scene.tactile_clay
    if arguments.frames:
        properties.use_scene_range = False
        properties.frame_start, properties.frame_end = arguments.frames
    if arguments.cache is not None:
        properties.cache_directory = _absolute(arguments.cache)
    _save_file("bake")


def _save_file(what: str) -> None:
    import bpy

    if not bpy.data.filepath:
        raise _CommandError(f"The {what} is done, but the .blend has no name to be saved under.")
    try:
        bpy.ops.wm.save_mainfile()
    except RuntimeError as error:
        raise _CommandError(
            f"The {what} is done, but the .blend cannot be saved: {error}"
        ) from error


COMMANDS = {
    "bake": _bake,
    "export": _export,
    "deliver": _deliver,
    "render": _render,
    "info": _info,
    "array-server": _array_server,
    "demo": _demo,
    "track": _track,
}
"""What carries each command out."""


class _BlenderCommand:
    """The entry for ``blender -c clay``, while the add-on is enabled."""

    def __init__(self) -> None:
        self._handle: Any = None

    def register(self) -> None:
        """Make ``blender -c clay`` known."""
        import bpy

        self._handle = bpy.utils.register_cli_command("clay", main_in_blender)

    def unregister(self) -> None:
        """Forget ``blender -c clay``; without it, do nothing."""
        import bpy

        if self._handle is not None:
            bpy.utils.unregister_cli_command(self._handle)
            self._handle = None


_blender_command = _BlenderCommand()
register = _blender_command.register
unregister = _blender_command.unregister
