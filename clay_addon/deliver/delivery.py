# SPDX-License-Identifier: GPL-3.0-or-later
"""Delivery: the surface of the clay over time as USD or Alembic, played by stock Blender.

The delivered surface is the exact one (`core.surface.exact`), not that of the geometry nodes. It
takes five times as long (half a second of CPU time for 15,000 particles), but it preserves the
volume of the particles, while the volume of the nodes' surface is off by up to 5 % and fluctuates
as the clay deforms. Clay objects that touch become one piece.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import bpy

from ..base.activity import ActivityKind, BusyError, clay_activity
from ..base.clock import go_to, shown_moment
from ..base.units import meters_per_unit
from ..core.storage.atomic_files import replace_file
from ..core.storage.cache import CacheError
from ..core.storage.playback import MAX_FRAME, NO_SUCH_FRAME
from ..core.surface.exact import SurfaceError
from ..model.clay_scene import clay_objects, frames_per_second
from ..model.properties import frame_range
from ..playback.playback import cache_of
from ..playback.shown_clay import ShownClay, ShownClayError, moves, particles_surface
from .files import FRAMES_FOLDER, ROOT_NAME, FrameWriter, write_root
from .folder import MANIFEST_NAME, DeliveryError, partial_folder, replace_folder, resolve_folder
from .object import close_delivery, show_delivery

__all__ = [
    "DeliveryError",
    "DeliveryProgress",
    "DeliveryResult",
    "deliver",
    "deliver_steps",
]

KINDS = ("usd", "abc")


@dataclass(frozen=True)
class DeliveryProgress:
    """Progress of a delivery."""

    frame: int
    """The frame just finished."""
    done: int
    """Number of frames done, out of `total`."""
    total: int
    """Number of frames in the range."""
    bytes: int
    """Size on disk so far [bytes]."""
    seconds_left: float | None
    """Estimated remaining time [s]; None while unknown."""


@dataclass(frozen=True)
class DeliveryResult:
    """Result and statistics of a delivery."""

    file: Path
    """The file to open; the first of a sequence for Alembic."""
    start: int
    """First frame."""
    end: int
    """Last frame."""
    shapes: int
    """Number of shapes written; fewer than the frames if shapes are held."""
    particle_count: int
    """Number of particles in the last shape."""
    vertex_count: int
    """Largest number of vertices in a shape."""
    volume_error: float
    """Largest relative difference between the volumes of a surface and its particles."""
    bytes: int
    """Size on disk [bytes]."""
    bytes_per_shape: int
    """Median size of a shape on disk [bytes]."""
    seconds: float
    """Duration of the delivery [s]."""
    seconds_per_shape: float
    """Median time per shape [s]."""
    object_name: str
    """Name of the object that plays the files; empty if there is none."""


@dataclass
class _DeliveryTally:
    """Statistics collected during a delivery."""

    seconds: list[float] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    volume_errors: list[float] = field(default_factory=list)
    vertices: int = 0
    particles: int = 0


def deliver(
    context: bpy.types.Context,
    *,
    kind: str = "usd",
    start: int | None = None,
    end: int | None = None,
    directory: str | os.PathLike[str] | None = None,
    points: bool = False,
    show: bool = True,
    progress: Callable[[DeliveryProgress], object] | None = None,
) -> DeliveryResult | None:
    """Write the surface of the clay over time, and play it in place of the clay.

    Args:
        context: The clay of its scene is delivered: baked, packed, keyed or sculpted.
        kind: ``usd``, or ``abc`` for Alembic, which has neither velocities (so no motion blur) nor
            more than 8 bits per color channel.
        start: First frame; by default from the scene's settings, limited to the bake.
        end: Last frame; by default from the scene's settings, limited to the bake.
        directory: Folder of the delivery; by default from the scene's settings.
        points: Whether USD files also contain the particles.
        show: Whether to add an object that plays the files, and hide the clay.
        progress: Called after each frame; the delivery stops if it returns False.

    Returns:
        The result; None if the delivery was stopped, which changes nothing.

    Raises:
        DeliveryError: The clay cannot be delivered, the folder cannot be used, or a frame failed.
            An earlier delivery is unchanged.
    """
    steps = deliver_steps(
        context, kind=kind, start=start, end=end, directory=directory, points=points, show=show
    )
    while True:
        try:
            report = next(steps)
        except StopIteration as finished:
            return finished.value
        if progress is not None and progress(report) is False:
            steps.close()
            return None


def deliver_steps(
    context: bpy.types.Context,
    *,
    kind: str = "usd",
    start: int | None = None,
    end: int | None = None,
    directory: str | os.PathLike[str] | None = None,
    points: bool = False,
    show: bool = True,
) -> Generator[DeliveryProgress, None, DeliveryResult]:
    """Deliver as `deliver` does, in a generator that yields after each frame.

    Closing the generator stops the delivery and changes nothing.
    """
    try:
        clay_activity.check_free()
    except BusyError as error:
        raise DeliveryError(str(error)) from error
    frames = _deliver_frames(context, kind, start, end, directory, points, show)
    return (yield from clay_activity.run_steps(ActivityKind.DELIVERY, frames))


def _deliver_frames(
    context: bpy.types.Context,
    kind: str,
    start: int | None,
    end: int | None,
    directory: str | os.PathLike[str] | None,
    points: bool,
    show: bool,
) -> Generator[DeliveryProgress, None, DeliveryResult]:
    scene = context.scene
    began = time.perf_counter()
    if kind not in KINDS:
        raise DeliveryError(f"The format must be one of {', '.join(KINDS)}, not {kind!r}.")
    _check_build(kind)
    target = resolve_folder(scene, directory)
    clay = clay_objects(scene)
    if not clay:
        raise DeliveryError("There is no clay to deliver. Make clay first.")
    tally = _DeliveryTally()
    previous = shown_moment(scene)
    try:
        shown = ShownClay(scene, clay, cache_of(scene))
        first, last = _range(scene, shown, start, end)
        keys = (key for number in range(first, last + 1) for key in shown.key(number))
        if shown.sculpted and any(key[0] == "own" for key in keys):
            raise DeliveryError(
                "The clay was sculpted after it was baked, so it does not play the bake. Bake "
                "again, undo, or Free the bake to deliver the sculpted shape."
            )
        with partial_folder(target) as folder:
            shapes = yield from _write_frames(
                scene, shown, folder, kind, first, last, points, tally
            )
            files = {number: name for number, (name, _) in shapes.items()}
            object_path = shapes[first][1]
            if kind == "usd":
                write_root(
                    folder / ROOT_NAME,
                    {number: folder / FRAMES_FOLDER / name for number, name in files.items()},
                    last=last,
                    frames_per_second=frames_per_second(scene),
                    meters_per_unit=meters_per_unit(scene),
                )
            _write_manifest(folder, kind, first, last, files, object_path)
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
            if show:
                # Some systems cannot move a folder that contains an open file.
                close_delivery(scene)
            replace_folder(folder, target)
    except ReferenceError as error:
        raise DeliveryError(
            "An object in the delivery was deleted, or replaced by Undo, during the delivery. "
            "Nothing was changed; try again."
        ) from error
    except (ShownClayError, SurfaceError, CacheError) as error:
        raise DeliveryError(str(error)) from error
    except ImportError as error:
        raise DeliveryError(
            "The package pysplashsurf is missing, so no surface can be made. Install the extension "
            "from the zip for this platform."
        ) from error
    except OSError as error:
        raise DeliveryError(
            f"{target} could not be written ({error.strerror or error}). An earlier delivery is "
            "unchanged. Choose another folder, or free some space."
        ) from error
    finally:
        # Undo replaces the scene, too.
        with suppress(ReferenceError):
            if shown_moment(scene) != previous:
                go_to(scene, previous)
    name = ""
    if show:
        with_points = points and kind == "usd"
        played = show_delivery(scene, clay, target, kind, files, object_path, points=with_points)
        name = played.name
    return DeliveryResult(
        file=target / (ROOT_NAME if kind == "usd" else f"{FRAMES_FOLDER}/{files[first]}"),
        start=first,
        end=last,
        shapes=len(tally.sizes),
        particle_count=tally.particles,
        vertex_count=tally.vertices,
        volume_error=max(tally.volume_errors, key=abs),
        bytes=size,
        bytes_per_shape=round(median(tally.sizes)),
        seconds=time.perf_counter() - began,
        seconds_per_shape=median(tally.seconds),
        object_name=name,
    )


def _check_build(kind: str) -> None:
    options = bpy.app.build_options
    if not (options.usd if kind == "usd" else options.alembic):
        name = "USD" if kind == "usd" else "Alembic"
        raise DeliveryError(
            f"This build of Blender does not support {name}. Use the build from blender.org, or "
            "Pack Playback, which needs no files."
        )


def _range(
    scene: bpy.types.Scene, shown: ShownClay, start: int | None, end: int | None
) -> tuple[int, int]:
    first, last = frame_range(scene)
    keyed = any(key[0] == "pose" for key in shown.key(first) + shown.key(last))
    if shown.baked and not keyed:
        # Nothing moves before or after the bake.
        first, last = max(first, shown.baked[0]), min(last, shown.baked[-1])
        if last < first:
            first, last = shown.baked[0], shown.baked[-1]
    first = first if start is None else start
    last = last if end is None else end
    if last < first:
        raise DeliveryError(f"The range ends (frame {last}) before it starts (frame {first}).")
    for number in (first, last):
        if abs(number) > MAX_FRAME:
            raise DeliveryError(NO_SUCH_FRAME.format(number))
    return first, last


def _write_frames(
    scene: bpy.types.Scene,
    shown: ShownClay,
    folder: Path,
    kind: str,
    first: int,
    last: int,
    points: bool,
    tally: _DeliveryTally,
) -> Generator[DeliveryProgress, None, dict[int, tuple[str, str]]]:
    """Write each shape once, and return the file name and object path shown at each frame."""
    files: dict[tuple[tuple[object, ...], ...], str] = {}
    shapes: dict[int, tuple[str, str]] = {}
    (folder / FRAMES_FOLDER).mkdir()
    rate = scene.render.fps, scene.render.fps_base
    writer = FrameWriter(
        folder / FRAMES_FOLDER, kind, first=first, frames_per_second=rate, points=points
    )
    total = last + 1 - first
    began = time.perf_counter()
    moving = any(moves(item) for item in clay_objects(scene))
    for number in range(first, last + 1):
        key = shown.key(number)
        if key not in files:
            if moving:
                scene.frame_set(number)
            start = time.perf_counter()
            particles = shown.read(number)
            surface, count, volume = particles_surface(particles, moving=kind == "usd")
            tally.sizes.append(writer.write(number, surface, particles))
            tally.seconds.append(time.perf_counter() - start)
            tally.volume_errors.append(surface.volume / volume - 1)
            tally.vertices = max(tally.vertices, len(surface.vertices))
            tally.particles = count
            files[key] = writer.path(number).name
        shapes[number] = files[key], writer.object_path
        done = number + 1 - first
        left = (time.perf_counter() - began) / done * (total - done)
        yield DeliveryProgress(number, done, total, sum(tally.sizes), left)
    return shapes


def _write_manifest(
    folder: Path, kind: str, first: int, last: int, shapes: dict[int, str], object_path: str
) -> None:
    table = {
        "format": kind,
        "start": first,
        "end": last,
        "object_path": object_path,
        "shapes": shapes,
    }
    text = json.dumps(table, indent=1) + "\n"
    replace_file(
        folder / MANIFEST_NAME,
        folder / f"{MANIFEST_NAME}.tmp",
        lambda file: file.write(text.encode()),
    )
