# SPDX-License-Identifier: GPL-3.0-or-later
"""Delivery: the clay's surface over time as USD or Alembic, played by stock Blender.

What is delivered is the exact surface (`surface.reconstruct`), not that of the look's geometry
nodes: it takes five times as long (half a second of processor time for 15,000 particles), but its
volume stays that of the particles, where the nodes' is off by up to 5 % and so breathes as clay is
worked, and clay objects that touch are one piece.
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
from ..base.units import meters_per_unit
from ..core.storage.atomic_files import replace_file
from ..core.storage.cache import CacheError
from ..core.surface.exact import SurfaceError
from ..model.clay_scene import clay_objects, frames_per_second
from ..model.properties import frame_range
from ..playback.playback import cache_of
from ..playback.shown_clay import ShownClay, ShownClayError, moves, particles_surface
from .files import FRAMES_FOLDER, ROOT_NAME, FrameWriter, write_root
from .folder import NOTE, DeliveryError, partial_folder, replace_folder, resolve_folder
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
    """How far a delivery is."""

    frame: int
    """The frame just finished."""
    done: int
    """Frames done, of `total`."""
    total: int
    """Frames in the range."""
    bytes: int
    """Bytes on the disk so far."""
    seconds_left: float | None
    """Time the rest will take [s]; None while that is unknown."""


@dataclass(frozen=True)
class DeliveryResult:
    """What a delivery did."""

    file: Path
    """The file to open; the first of a sequence for Alembic."""
    start: int
    """First frame."""
    end: int
    """Last frame."""
    shapes: int
    """Shapes written; fewer than frames where shapes are held."""
    particle_count: int
    """Number of particles in the last shape."""
    vertex_count: int
    """Largest number of vertices of a shape."""
    volume_error: float
    """Largest difference of a surface's volume from the particles' own, as a fraction."""
    bytes: int
    """Size on the disk."""
    bytes_per_shape: int
    """Median size of a shape on the disk."""
    seconds: float
    """Time it took [s]."""
    seconds_per_shape: float
    """Median time a shape took [s]."""
    object_name: str
    """The object that plays it; empty where none was wanted."""


@dataclass
class _DeliveryTally:
    """Figures gathered on the way."""

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
    """Write the clay's surface over time, and play it in place of the clay.

    Args:
        context: Its scene's clay is delivered: baked, packed, keyed or as it was sculpted.
        kind: ``usd``, or ``abc`` for Alembic, which keeps neither velocities (so no motion blur)
            nor colors of more than eight bits.
        start: First frame; the scene's setting, or the bake's first frame, where not given.
        end: Last frame; the scene's setting, or the bake's last frame, where not given.
        directory: Folder of the delivery; the scene's setting where not given.
        points: Whether USD gets the particles too.
        show: Whether to make an object that plays the files, and hide the clay.
        progress: Called after each frame; the delivery stops if it returns False.

    Returns:
        What was done; None where it was stopped, which leaves everything as it was.

    Raises:
        DeliveryError: the clay or the folder cannot be delivered to, or a frame failed. What was
            delivered before is as it was.
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
    """The same as `deliver`, as a generator that yields after each frame.

    Closing it stops the delivery, and leaves everything as it was.
    """
    try:
        clay_activity.check_free()
    except BusyError as error:
        raise DeliveryError(str(error)) from error
    frames = _deliver_frames(context, kind, start, end, directory, points, show)
    return (yield from clay_activity.through(ActivityKind.DELIVERY, frames))


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
    previous = scene.frame_current, scene.frame_subframe
    try:
        shown = ShownClay(scene, clay, cache_of(scene))
        first, last = _range(scene, shown, start, end)
        keys = (key for number in range(first, last + 1) for key in shown.key(number))
        if shown.sculpted and any(key[0] == "own" for key in keys):
            raise DeliveryError(
                "The clay was sculpted since it was baked, so it does not play that bake. Bake "
                "again, undo, or Free the bake to deliver what was sculpted."
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
            _write_note(folder, kind, first, last, files, object_path)
            size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
            if show:
                # An open file keeps some systems from moving its folder.
                close_delivery(scene)
            replace_folder(folder, target)
    except ReferenceError as error:
        raise DeliveryError(
            "Something that is delivered was deleted, or replaced by Undo, on the way. Nothing was "
            "changed; try again."
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
            f"{target} could not be written ({error.strerror or error}). What was there is as it "
            "was. Choose another folder, or free some space."
        ) from error
    finally:
        # Undo replaces the scene.
        with suppress(ReferenceError):
            if (scene.frame_current, scene.frame_subframe) != previous:
                scene.frame_set(previous[0], subframe=previous[1])
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
    there = bpy.app.build_options.usd if kind == "usd" else bpy.app.build_options.alembic
    if not there:
        name = "USD" if kind == "usd" else "Alembic"
        raise DeliveryError(
            f"This build of Blender has no {name}. Use the one from blender.org, or Pack Playback, "
            "which needs no files."
        )


def _range(
    scene: bpy.types.Scene, shown: ShownClay, start: int | None, end: int | None
) -> tuple[int, int]:
    first, last = frame_range(scene)
    keyed = any(key[0] == "pose" for key in shown.key(first) + shown.key(last))
    if shown.baked and not keyed:
        # Before and after the bake nothing moves.
        first, last = max(first, shown.baked[0]), min(last, shown.baked[-1])
        if last < first:
            first, last = shown.baked[0], shown.baked[-1]
    first = first if start is None else start
    last = last if end is None else end
    if last < first:
        raise DeliveryError(f"The range ends (frame {last}) before it starts (frame {first}).")
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
    """Write every shape once; gives the file and its object path from each frame on."""
    files: dict[tuple[tuple[object, ...], ...], str] = {}
    shapes: dict[int, tuple[str, str]] = {}
    (folder / FRAMES_FOLDER).mkdir()
    rate = scene.render.fps, scene.render.fps_base
    writer = FrameWriter(folder / FRAMES_FOLDER, kind, frames_per_second=rate, points=points)
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


def _write_note(
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
    replace_file(folder / NOTE, folder / f"{NOTE}.tmp", lambda file: file.write(text.encode()))
