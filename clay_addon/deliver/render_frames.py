# SPDX-License-Identifier: GPL-3.0-or-later
"""Render baked frames, any share of a shot at a time, as render farms do.

Blender's own ``-f`` renders whatever shape playback happens to have when a frame is not baked, and
a machine that dies leaves half a picture which the next one takes for done. Here a frame that is
not baked is an error before anything is rendered, and a picture is there whole or not at all.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...solver.core.errors import TactileClayError
from ..core.storage.atomic_files import replace_file
from ..core.storage.playback import held_frame
from ..model.clay_scene import clay_objects
from ..playback.playback import cache_of, message
from ..playback.poses import plays_itself
from .object import delivered_object

__all__ = ["FrameNotBakedError", "RenderError", "RenderProgress", "RenderResult", "render_frames"]


class RenderError(TactileClayError):
    """Frames cannot be rendered; the message says why and what to do."""


class FrameNotBakedError(RenderError):
    """A frame to render is missing in the bake, or damaged."""


@dataclass(frozen=True)
class RenderProgress:
    """How far a render is."""

    frame: int
    """The frame just finished."""
    path: Path
    """Its picture."""
    done: int
    """Frames done, of `total`."""
    total: int
    """Frames to render."""


@dataclass(frozen=True)
class RenderResult:
    """What a render did."""

    rendered: int
    """Frames that were rendered and written."""
    kept: int
    """Frames whose picture was there already."""
    files: tuple[Path, ...]
    """The picture of each frame, in the order asked for."""


def render_frames(
    context: bpy.types.Context,
    frames: Sequence[int],
    *,
    output: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Callable[[RenderProgress], object] | None = None,
) -> RenderResult:
    """Render frames of a scene to pictures, with the scene's engine and format.

    Args:
        context: Its scene is rendered; its frame and settings are the same afterwards.
        frames: Frame numbers.
        output: Path of the pictures, in which ``####`` stands for the frame's number, as in
            Blender's own output path; the scene's where not given.
        resume: Keep the pictures that are there.
        progress: Called after each frame that was rendered.

    Raises:
        FrameNotBakedError: The clay is not baked at a frame.
        RenderError: The scene renders to a film, which cannot be made in parts, Blender cannot
            render it (there is no camera, say), or a picture cannot be written.
    """
    scene = context.scene
    render = scene.render
    if render.is_movie_format:
        raise RenderError(
            f"The scene's output format is a film ({render.image_settings.file_format}). Choose a "
            "format of pictures, such as PNG, and make a film of them afterwards."
        )
    _check_baked(scene, frames)
    files = []
    rendered = 0
    with _own_settings(scene), tempfile.TemporaryDirectory(prefix="clay-render-") as folder:
        if output is not None:
            render.filepath = os.fspath(output)
        pattern = render.filepath
        for done, frame in enumerate(frames, start=1):
            render.filepath = pattern
            path = Path(bpy.path.abspath(render.frame_path(frame=frame))).absolute()
            files.append(path)
            if resume and path.is_file():
                continue
            _render_frame(scene, frame, path, Path(folder))
            rendered += 1
            if progress is not None:
                progress(RenderProgress(frame, path, done, len(frames)))
    return RenderResult(rendered, len(frames) - rendered, tuple(files))


def _check_baked(scene: bpy.types.Scene, frames: Sequence[int]) -> None:
    """Refuse frames that playback would show with another frame's shape."""
    frames = [frame for frame in frames if _shows_bake(scene, frame)]
    if not frames:
        return
    cache = cache_of(scene)
    baked = set(cache.frames()) if cache else set()
    if cache is None or not baked:
        raise FrameNotBakedError(
            "Nothing is baked"
            + (f" in {cache.directory}" if cache else "")
            + ". Bake first, or say with --cache where the bake is."
        )
    # Before its first frame the clay rests, which is what that frame holds.
    first, hold = min(baked), scene.tactile_clay.hold_frames
    missing = sorted({held_frame(f, first=first, hold=hold) for f in frames if f >= first} - baked)
    if missing:
        shown = ", ".join(str(frame) for frame in missing[:8])
        more = f" and {len(missing) - 8} more" if len(missing) > 8 else ""
        raise FrameNotBakedError(
            f"Not baked in {cache.directory}: frame {shown}{more}. Bake them, or go on with "
            "bake --resume."
        )


def _shows_bake(scene: bpy.types.Scene, frame: int) -> bool:
    """Whether any clay is seen as it was baked: not delivered, packed, or keyed as a pose."""
    if delivered_object(scene) is not None:
        return False
    return not all(plays_itself(item, frame) for item in clay_objects(scene))


def _render_frame(scene: bpy.types.Scene, frame: int, path: Path, folder: Path) -> None:
    """Render one frame into a folder of this machine, then put the picture where it belongs."""
    scene.frame_set(frame)
    if message(scene) and _shows_bake(scene, frame):
        raise FrameNotBakedError(message(scene))
    # As an animation of one frame, so that compositing and names are those of Blender's own.
    scene.frame_start = scene.frame_end = frame
    # A path that ends in a slash has no name, only the number.
    scene.render.filepath = os.path.join(folder, os.path.basename(scene.render.filepath))  # noqa: PTH118, PTH119
    try:
        bpy.ops.render.render(animation=True, scene=scene.name)
    except RuntimeError as error:
        raise RenderError(f"Frame {frame} cannot be rendered: {error}") from error
    written = [file for file in folder.iterdir() if file.is_file()]
    if not written:
        raise RenderError(f"Frame {frame} was not rendered: Blender wrote no picture.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for file in written:
            _place(file, path.parent / file.name)
    except OSError as error:
        raise RenderError(f"{path} cannot be written: {error.strerror or error}.") from error


def _place(file: Path, target: Path) -> None:
    """Move a file, also to another disk, so that the target is there whole or not at all."""
    with file.open("rb") as source:
        replace_file(
            target,
            target.parent / f".clay-{os.getpid()}-{target.stem}.tmp",
            lambda copy: shutil.copyfileobj(source, copy),
        )
    file.unlink()


@contextmanager
def _own_settings(scene: bpy.types.Scene) -> Iterator[None]:
    """Let the context change what says which frames are rendered to where, and put it back."""
    render = scene.render
    kept = [
        (owner, name, getattr(owner, name))
        for owner, name in (
            (render, "filepath"),
            (render, "use_overwrite"),
            (render, "use_placeholder"),
            (scene, "frame_start"),
            (scene, "frame_end"),
            (scene, "frame_step"),
        )
    ]
    frame = scene.frame_current, scene.frame_subframe
    render.use_overwrite = True
    render.use_placeholder = False
    scene.frame_step = 1
    try:
        yield
    finally:
        for owner, name, value in kept:
            setattr(owner, name, value)
        scene.frame_set(frame[0], subframe=frame[1])
