# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: bake, render, deliver, export and look into .blend files, and track hands.

The same words serve ``tactile-clay bake FILE.blend`` (with the bpy module) and
``blender -b FILE.blend -c clay bake`` (inside Blender, on the file that is open).
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from .demo_scenes import DEFAULT, SCENES
from .tracking.command import add_command as add_track

if TYPE_CHECKING:
    from .bake import BakeProgress
    from .delivery import DeliveryProgress

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_STALE = 3
EXIT_INTERRUPTED = 130

_Outcome = tuple[int, str]
"""Exit code, and what to print on the standard output."""

_EXIT_CODES = """\
exit codes:
  0    done
  1    failed; the message says why and what to do
  2    the command was not understood, or FILE.blend is not there
  3    the bake is stale or not complete: bake again, or resume
  130  interrupted; what is baked is kept, and --resume goes on
"""


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
    parser = _parser(program, names_file=names_file)
    try:
        arguments = parser.parse_args(list(argv))
    except SystemExit as end:
        return int(end.code or 0)
    try:
        # What Blender and Warp print belongs to the standard error: the standard output has the
        # result and nothing else.
        with contextlib.nullcontext() if _prints_itself(arguments) else _diverted():
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


def _parser(program: str, *, names_file: bool) -> argparse.ArgumentParser:
    def describe(text: str) -> dict[str, Any]:
        return {
            "help": text,
            "description": text[0].upper() + text[1:] + ".",
            "epilog": _EXIT_CODES,
            "formatter_class": argparse.RawDescriptionHelpFormatter,
        }

    parser = argparse.ArgumentParser(
        prog=program,
        description="Simulate, export and inspect the clay of .blend files.",
        epilog=_EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(
        name: str, text: str, carry_out: Callable[[argparse.Namespace], _Outcome]
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(name, **describe(text))
        command.set_defaults(carry_out=carry_out, file=None)
        return command

    def add_file_options(command: argparse.ArgumentParser) -> None:
        if names_file:
            command.add_argument("file", metavar="FILE.blend", type=Path)
        command.add_argument(
            "--scene", metavar="NAME", help="the scene (default: the file's active one)"
        )
        command.add_argument(
            "--cache", metavar="DIR", help="the cache folder (default: the scene's)"
        )
        command.add_argument("--json", action="store_true", help="print the result as JSON")

    bake = add("bake", "simulate the clay into its cache", _bake)
    add_file_options(bake)
    bake.add_argument(
        "--frames",
        metavar="A-B",
        type=_frame_range,
        help="frames to bake, as 1-120, or --frames=-10-50 where the first is negative "
        "(default: the scene's range)",
    )
    bake.add_argument(
        "--resume", action="store_true", help="keep the frames that are there and go on"
    )
    bake.add_argument(
        "--device",
        choices=("auto", "cpu", "cuda:0"),
        help="where to compute (default: the preferences')",
    )
    bake.add_argument(
        "--replace", action="store_true", help="bake over the cache of another .blend or scene"
    )
    bake.add_argument(
        "--save", action="store_true", help="store --frames and --cache in the .blend, for playback"
    )

    bake.add_argument(
        "--again",
        action="store_true",
        help="bake the recorded take of the scene with finer clay, in a scene of its own, and save "
        "that in the .blend; with --resume go on with it",
    )
    bake.add_argument(
        "--spacing",
        metavar="MM",
        type=_positive,
        help="with --again: distance between particles in millimetres (default: half the live one)",
    )
    bake.add_argument(
        "--substeps",
        metavar="N",
        type=int,
        default=0,
        help="with --again: solver steps in each sixtieth of a second (default: the solver's own)",
    )

    export = add("export", "write the clay at a frame as one watertight mesh", _export)
    add_file_options(export)
    export.add_argument(
        "--frame", type=int, metavar="N", help="the frame (default: the file's current one)"
    )
    export.add_argument(
        "--output",
        type=Path,
        required=True,
        metavar="FILE",
        help="the file to write: .stl, .3mf, .obj, .ply or .glb",
    )
    export.add_argument(
        "--unit",
        choices=("auto", "m", "mm"),
        default="auto",
        help="unit of the numbers in the file (default: mm in .stl and .3mf, else m)",
    )
    export.add_argument(
        "--base", type=float, default=0.0, metavar="MM", help="cut so much off for a flat base"
    )
    export.add_argument(
        "--wall",
        type=float,
        default=1.0,
        metavar="MM",
        help="warn of thinner walls in .stl and .3mf (default: 1)",
    )

    deliver = add("deliver", "write the clay over time as USD or Alembic, with a player", _deliver)
    add_file_options(deliver)
    deliver.add_argument(
        "--frames",
        metavar="A-B",
        type=_frame_range,
        help="frames to write (default: the scene's range, as far as it is baked)",
    )
    deliver.add_argument(
        "--format", choices=("usd", "abc"), help="usd or abc (default: the scene's, usd)"
    )
    deliver.add_argument("--points", action="store_true", help="write the particles too (usd)")
    deliver.add_argument(
        "--output", metavar="DIR", help="the folder of the delivery (default: the scene's)"
    )
    deliver.add_argument(
        "--save",
        action="store_true",
        help="play the files in place of the clay, and store that in the .blend",
    )

    render = add("render", "render baked frames, each whole or not at all", _render)
    add_file_options(render)
    render.add_argument(
        "--frames",
        metavar="LIST",
        type=_frame_list,
        help="frames to render, as 1-120 or 1-10,15,20 (default: the scene's range)",
    )
    render.add_argument(
        "--output",
        metavar="PATH",
        help="path of the pictures, as pictures/frame_#### (default: the scene's)",
    )
    render.add_argument("--resume", action="store_true", help="keep the pictures that are there")

    info = add("info", "tell what clay a file holds and what is baked", _info)
    add_file_options(info)

    if names_file:
        from ..haptics.array_server.command import add_arguments as add_server_arguments

        server = add("array-server", "drive an ultrasound array with focal points", _array_server)
        add_server_arguments(server)

    demo = add("demo", "make and render a scene of the gallery", _demo)
    demo.add_argument(
        "--scene",
        choices=list(SCENES),
        default=DEFAULT,
        help="; ".join(f"{name}: {scene.what}" for name, scene in SCENES.items()),
    )
    demo.add_argument("--output", type=Path, metavar="DIR", help="where it goes")
    add_track(commands, carry_out=_track)
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0")
    return value


def _frame_range(text: str) -> tuple[int, int]:
    """Two frame numbers from ``1-120``; either may be negative: ``-10--1``."""
    for split in range(1, len(text)):
        if text[split] == "-":
            with contextlib.suppress(ValueError):
                start, end = int(text[:split]), int(text[split + 1 :])
                if end < start:
                    raise argparse.ArgumentTypeError(f"{text!r} ends before it starts")
                return start, end
    raise argparse.ArgumentTypeError(f"{text!r} is not a range such as 1-120")


def _frame_list(text: str) -> list[int]:
    """Frame numbers from ``1-10,15``, sorted, each once."""
    frames: set[int] = set()
    for part in text.split(","):
        try:
            frames.add(int(part))
        except ValueError:
            start, end = _frame_range(part.strip())
            frames.update(range(start, end + 1))
    return sorted(frames)


# The commands ----------------------------------------------------------------------------------


def _bake(arguments: argparse.Namespace) -> _Outcome:
    if not arguments.again and (arguments.spacing or arguments.substeps):
        raise _CommandError("--spacing and --substeps go with --again.", EXIT_USAGE)
    context, scene = _open(arguments)
    from .bake import BakeError, BakeStaleError, bake
    from .cache import CacheError

    if arguments.again:
        scene = _film(context, scene, arguments)
    start, end = arguments.frames or (None, None)
    line = _ProgressLine(sys.stderr)
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
    return EXIT_DONE, _text(
        arguments,
        table,
        f"Frames {result.start} to {result.end}: {result.baked} baked, {result.kept} kept{pace} "
        f"({result.particle_count:,} particles on {result.device}).\nCache: {result.directory}",
    )


def _film(context: Any, scene: Any, arguments: argparse.Namespace) -> Any:
    """The scene in which a scene's take is baked again."""
    import bpy

    from .sculpt.film import FilmError, make_film

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


def _export(arguments: argparse.Namespace) -> _Outcome:
    context, scene = _open(arguments)
    from .export import ExportError, check_target, export_clay
    from .playback import message, shown_frame
    from .poses import plays_itself
    from .simulation import clay_objects
    from .surface import SurfaceError

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
    return EXIT_DONE, _text(
        arguments,
        {"frame": frame, "shown_frame": shown, **table},
        f"Frame {frame} written to {table['file']}: {table['faces']:,} triangles, watertight, "
        f"volume {volume_error:+.2%} off the particles' own.",
    )


def _deliver(arguments: argparse.Namespace) -> _Outcome:
    context, scene = _open(arguments)
    from .delivery import DeliveryError, deliver
    from .delivery_operators import describe

    properties = scene.tactile_clay
    if arguments.cache is not None:
        properties.cache_directory = _absolute(arguments.cache)
    output = _absolute(arguments.output)
    start, end = arguments.frames or (None, None)
    line = _ProgressLine(sys.stderr)
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
    return EXIT_DONE, _text(
        arguments,
        asdict(result),
        f"{describe(result)} ({result.particle_count:,} particles, up to "
        f"{result.vertex_count:,} vertices).\nOpen: {result.file}",
    )


def _render(arguments: argparse.Namespace) -> _Outcome:
    context, scene = _open(arguments)
    from .render_frames import FrameNotBakedError, RenderError, RenderProgress, render_frames

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
    return EXIT_DONE, _text(
        arguments,
        asdict(result),
        f"{result.rendered} frames rendered, {result.kept} kept.\n"
        f"Pictures: {result.files[0].parent}",
    )


def _info(arguments: argparse.Namespace) -> _Outcome:
    context, scene = _open(arguments)
    from .status import describe, inspect

    with context.temp_override(scene=scene):
        table = inspect(context, _absolute(arguments.cache))
    bake = table["bake"]
    unsound = bake["stale"] or bake["missing"] or bake["problem"]
    return EXIT_STALE if unsound else EXIT_DONE, _text(arguments, table, describe(table))


def _array_server(arguments: argparse.Namespace) -> _Outcome:
    from ..haptics.array_server.command import carry_out

    return carry_out(arguments), ""


def _demo(arguments: argparse.Namespace) -> _Outcome:
    _need_bpy()
    from . import demo

    words = ["--scene", arguments.scene]
    if arguments.output is not None:
        words += ["--output", str(arguments.output)]
    return demo.main(words), ""


def _track(arguments: argparse.Namespace) -> _Outcome:
    # A tracker's sender runs without Blender.
    from .tracking import TrackingError
    from .tracking.command import track

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
        from . import register

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


def _text(arguments: argparse.Namespace, table: dict[str, Any], text: str) -> str:
    return json.dumps(_without_nan(table), indent=2, default=str) if arguments.json else text


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def _diverted() -> Iterator[None]:
    """Send what Python and the C library print on the standard output to the standard error."""
    _flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        _flush()
        os.dup2(kept, 1)
        os.close(kept)


def _flush() -> None:
    """Flush the standard output, also the C library's, which Blender writes to."""
    sys.stdout.flush()
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None).fflush(None)


class _ProgressLine:
    """Tells how far something is: a bar on a terminal, now and then a plain line elsewhere."""

    _WIDTH = 24

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._bar = stream.isatty()
        self._told = -1

    def __call__(self, progress: BakeProgress | DeliveryProgress) -> None:
        from .bake_operators import duration_text

        share = progress.done / max(1, progress.total)
        left = f"{duration_text(progress.seconds_left)} left"
        text = f"frame {progress.frame}, {progress.done} of {progress.total}, {left}"
        if self._bar:
            filled = round(self._WIDTH * share)
            bar = "█" * filled + "░" * (self._WIDTH - filled)
            self._stream.write(f"\r{bar} {text}\033[K")
            self._stream.flush()
        elif int(10 * share) > self._told:
            self._told = int(10 * share)
            print(text, file=self._stream, flush=True)

    def end(self) -> None:
        """Leave the bar's line."""
        if self._bar:
            self._stream.write("\n")
            self._stream.flush()


_command: Any = None


def register() -> None:
    """Make ``blender -c clay`` known."""
    global _command
    import bpy

    _command = bpy.utils.register_cli_command("clay", main_in_blender)


def unregister() -> None:
    """Forget ``blender -c clay``."""
    global _command
    import bpy

    if _command is not None:
        bpy.utils.unregister_cli_command(_command)
        _command = None
