# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering of baked frames, in parts of a shot, as on a render farm.

With Blender's own ``-f``, a frame that is not baked is rendered with whatever shape playback shows,
and a machine that fails leaves a partial image that the next one takes for finished. Here, missing
frames are an error before anything is rendered, and images are written atomically.
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
from ..base.clock import animation_time, go_to, shown_moment
from ..core.storage.atomic_files import replace_file
from ..core.storage.playback import MAX_FRAME, NO_SUCH_FRAME, held_frame
from ..model.clay_scene import clay_objects
from ..playback.playback import cache_of, message
from ..playback.poses import needs_no_cache
from .object import delivered_object

__all__ = ["FrameNotBakedError", "RenderError", "RenderProgress", "RenderResult", "render_frames"]


class RenderError(TactileClayError):
    """Frames cannot be rendered; the message says why and what to do."""


class FrameNotBakedError(RenderError):
    """A frame to render is missing in the bake, or damaged."""


@dataclass(frozen=True)
class RenderProgress:
    """Progress of a render."""

    frame: int
    """The frame just finished."""
    path: Path
    """Image of the frame."""
    done: int
    """Number of frames done, out of `total`."""
    total: int
    """Number of frames to render."""


@dataclass(frozen=True)
class RenderResult:
    """Result of a render."""

    rendered: int
    """Number of frames rendered and written."""
    kept: int
    """Number of frames whose image already existed."""
    files: tuple[Path, ...]
    """The pictures on the disk, in the order of the frames asked for."""


def render_frames(
    context: bpy.types.Context,
    frames: Sequence[int],
    *,
    output: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Callable[[RenderProgress], object] | None = None,
) -> RenderResult:
    """Render frames of a scene to images, with the scene's engine and format.

    Args:
        context: Its scene is rendered; current frame and settings are restored afterward.
        frames: Frame numbers.
        output: Path of the images, in which ``####`` is replaced by the frame number, as in
            Blender's own output path; by default from the scene's settings.
        resume: Whether to keep existing images.
        progress: Called after each rendered frame.

    Raises:
        FrameNotBakedError: The clay is not baked at a frame.
        RenderError: The output format is a video, which cannot be made in parts, Blender cannot
            render the scene (without a camera, for example), or an image cannot be written.
    """
    scene = context.scene
    render = scene.render
    if render.is_movie_format:
        raise RenderError(
            f"The scene's output format is a video ({render.image_settings.file_format}). Choose "
            "an image format, such as PNG, and make a video from the images afterward."
        )
    for frame in frames:
        if abs(frame) > MAX_FRAME:
            raise RenderError(NO_SUCH_FRAME.format(frame))
    _check_baked(scene, frames)
    files: list[Path] = []
    rendered = 0
    with _temporary_settings(scene), tempfile.TemporaryDirectory(prefix="clay-render-") as folder:
        if output is not None:
            render.filepath = os.fspath(output)
        pattern = render.filepath
        for done, frame in enumerate(frames, start=1):
            render.filepath = pattern
            path = Path(bpy.path.abspath(render.frame_path(frame=frame))).absolute()
            if resume and path.is_file():
                files.append(path)
                continue
            files += _render_frame(scene, frame, path, Path(folder))
            rendered += 1
            if progress is not None:
                progress(RenderProgress(frame, path, done, len(frames)))
    return RenderResult(rendered, len(frames) - rendered, tuple(files))


def _check_baked(scene: bpy.types.Scene, frames: Sequence[int]) -> None:
    """Refuse frames that would show the shape of another frame because theirs is not baked."""
    frames = [frame for frame in frames if _shows_bake(scene, frame)]
    if not frames:
        return
    cache = cache_of(scene)
    baked = set(cache.frames()) if cache else set()
    if cache is None or not baked:
        raise FrameNotBakedError(
            "Nothing is baked"
            + (f" in {cache.directory}" if cache else "")
            + ". Bake first, or set the folder of the bake with --cache."
        )
    # Frames before the first one show its rest state.
    first, hold = min(baked), scene.tactile_clay.hold_frames
    missing = sorted({held_frame(f, first=first, hold=hold) for f in frames if f >= first} - baked)
    if missing:
        shown = ", ".join(str(frame) for frame in missing[:8])
        more = f" and {len(missing) - 8} more" if len(missing) > 8 else ""
        raise FrameNotBakedError(
            f"Not baked in {cache.directory}: frame {shown}{more}. Bake them, or continue with "
            "bake --resume."
        )


def _shows_bake(scene: bpy.types.Scene, frame: int) -> bool:
    """Whether any clay plays the bake at a frame, not a delivery, packed frames or a keyed pose."""
    if delivered_object(scene) is not None:
        return False
    time = animation_time(scene, frame)
    return not all(needs_no_cache(item, time) for item in clay_objects(scene))


def _render_frame(scene: bpy.types.Scene, frame: int, path: Path, folder: Path) -> list[Path]:
    """Render one frame into a folder of this machine, then put the picture where it belongs.

    Returns:
        What was written: one picture, or one for each eye of a stereo scene.
    """
    scene.frame_set(frame)
    if message(scene) and _shows_bake(scene, frame):
        raise FrameNotBakedError(message(scene))
    # As an animation of one frame, so that compositing and names are those of Blender's own. It
    # has none before frame 0, so there a still with the same name.
    animated = frame >= 0
    if animated:
        scene.frame_start = scene.frame_end = frame
        # A path that ends in a slash has no name, only the number.
        name = os.path.basename(scene.render.filepath)  # noqa: PTH119
    else:
        name = path.name
    scene.render.filepath = os.path.join(folder, name)  # noqa: PTH118
    try:
        bpy.ops.render.render(animation=animated, write_still=not animated, scene=scene.name)
    except RuntimeError as error:
        raise RenderError(f"Frame {frame} cannot be rendered: {error}") from error
    written = [file for file in folder.iterdir() if file.is_file()]
    if not written:
        raise RenderError(f"Frame {frame} was not rendered: Blender wrote no image.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        placed = sorted(path.parent / file.name for file in written)
        for file in written:
            _move(file, path.parent / file.name)
    except OSError as error:
        raise RenderError(f"{path} cannot be written: {error.strerror or error}.") from error
    return placed


def _move(file: Path, target: Path) -> None:
    """Move a file atomically, even to another disk."""
    with file.open("rb") as source:
        replace_file(
            target,
            target.parent / f".clay-{os.getpid()}-{target.stem}.tmp",
            lambda copy: shutil.copyfileobj(source, copy),
        )
    file.unlink()


@contextmanager
def _temporary_settings(scene: bpy.types.Scene) -> Iterator[None]:
    """Set up rendering of single frames, and restore the settings afterward."""
    render = scene.render
    previous = [
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
    moment = shown_moment(scene)
    render.use_overwrite = True
    render.use_placeholder = False
    scene.frame_step = 1
    try:
        yield
    finally:
        for owner, name, value in previous:
            setattr(owner, name, value)
        go_to(scene, moment)
