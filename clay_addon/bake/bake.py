# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake: simulate a scene frame by frame into its cache; stop and resume at any moment."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median

import bpy
import numpy as np

from ..base.activity import ActivityKind, BusyError, clay_activity
from ..base.preferences import ADDON_VERSION
from ..base.units import from_meters, meters_per_unit, to_meters
from ..core.storage.cache import Cache, Frame, Meta
from ..deliver.object import delivered_object
from ..model.cache_folder import owner_of
from ..model.clay_points import SCULPTED_MARK, write_colors
from ..model.clay_scene import SimulationError, clay_objects, frames_per_second, solver_device
from ..model.properties import frame_range
from ..playback.packed import is_packed
from ..playback.playback import paused, refresh
from ..simulate.simulation import Simulation
from ..touch.feeling import BakeTouch, own_touch
from ..wheel.wheel import WheelError, check_speeds, sample
from .checkpoints import Checkpoints, restore_checkpoint
from .checks import (
    BakeError,
    BakeStaleError,
    bake_cache,
    check_owner,
    check_resume,
)

__all__ = [
    "BakeError",
    "BakeProgress",
    "BakeResult",
    "BakeStaleError",
    "bake",
    "bake_steps",
    "free",
]


@dataclass(frozen=True)
class BakeProgress:
    """How far a bake is."""

    frame: int
    """The frame just finished."""
    done: int
    """Frames done, of `total`."""
    total: int
    """Frames in the range."""
    seconds_left: float | None
    """Time the rest will take [s]; None while that is unknown."""


@dataclass(frozen=True)
class BakeResult:
    """What a bake did."""

    directory: Path
    """The cache folder."""
    start: int
    """First frame of the range."""
    end: int
    """Last frame of the range."""
    baked: int
    """Frames that were simulated and written."""
    kept: int
    """Frames that were there already."""
    cancelled: bool
    """Whether it was stopped before the end; what is baked stays."""
    particle_count: int
    """Number of particles."""
    device: str
    """Where it was computed."""
    settings: dict[str, object]
    """The solver's settings."""
    seconds: float
    """Time it took [s]."""
    median_frame_milliseconds: float | None
    """Median time a frame took to simulate [ms]; None if none was."""
    volume_error: float | None
    """Largest mean compression of the clay in any frame, as a fraction."""
    max_penetration: float | None
    """Deepest that a particle lay inside a collider [m]."""
    overflow: int
    """Neighbors that found no free slot in the solver."""
    quarantined: int
    """Times a particle was held because its state was not finite."""
    warnings: tuple[str, ...] = ()
    """What the user should know about the result."""


@dataclass
class _BakeTally:
    """Figures gathered while baking."""

    written: int = 0
    seconds: list[float] = field(default_factory=list)
    volume_errors: list[float] = field(default_factory=list)
    penetrations: list[float] = field(default_factory=list)
    overflow: int = 0
    quarantined: int = 0
    warnings: list[str] = field(default_factory=list)


def bake(
    context: bpy.types.Context,
    *,
    start: int | None = None,
    end: int | None = None,
    directory: str | os.PathLike[str] | None = None,
    resume: bool = False,
    device: str | None = None,
    replace_other: bool = False,
    progress: Callable[[BakeProgress], object] | None = None,
) -> BakeResult:
    """Bake a scene's clay to its cache.

    Args:
        context: Its scene is baked; its current frame is the same afterwards.
        start: First frame, the rest state; the scene's setting where not given.
        end: Last frame; the scene's setting where not given.
        directory: Cache folder; the scene's setting where not given.
        resume: Keep the frames that are there and go on at the first missing one.
        device: ``auto``, ``cpu`` or ``cuda:0``; the preferences' where not given.
        replace_other: Bake over a cache that belongs to another .blend or scene.
        progress: Called after each frame; the bake stops if it returns False.

    Raises:
        BakeStaleError: `resume`, but the scene has changed since the bake.
        BakeError: The scene or the range cannot be baked.
        CacheError: The cache folder cannot be written to.
    """
    steps = bake_steps(
        context,
        start=start,
        end=end,
        directory=directory,
        resume=resume,
        device=device,
        replace_other=replace_other,
    )
    stop = False
    while True:
        try:
            report = steps.send(stop or None)
        except StopIteration as finished:
            return finished.value
        stop = progress is not None and progress(report) is False


def bake_steps(
    context: bpy.types.Context,
    *,
    start: int | None = None,
    end: int | None = None,
    directory: str | os.PathLike[str] | None = None,
    resume: bool = False,
    device: str | None = None,
    replace_other: bool = False,
) -> Generator[BakeProgress, bool | None, BakeResult]:
    """The same as `bake`, as a generator that yields after each frame.

    Sending True stops it: the frames so far are kept, with a checkpoint to resume from. Closing
    it does the same. The scene's frame is put back either way.
    """
    try:
        clay_activity.check_free()
    except BusyError as error:
        raise BakeError(str(error)) from error
    frames = _bake_frames(context, start, end, directory, resume, device, replace_other)
    return (yield from clay_activity.through(ActivityKind.BAKE, frames))


def _bake_frames(
    context: bpy.types.Context,
    start: int | None,
    end: int | None,
    directory: str | os.PathLike[str] | None,
    resume: bool,
    device: str | None,
    replace_other: bool,
) -> Generator[BakeProgress, bool | None, BakeResult]:
    scene = context.scene
    began = time.perf_counter()
    default_start, default_end = frame_range(scene)
    start = default_start if start is None else start
    end = default_end if end is None else end
    if end < start:
        raise BakeError(f"The range ends (frame {end}) before it starts (frame {start}).")
    cache = bake_cache(scene, directory)
    # Take up what was done to the points since the last change of frame.
    refresh(scene)
    previous = scene.frame_current, scene.frame_subframe
    tally = _BakeTally()
    cancelled = False
    with paused(), own_touch():
        try:
            sample(scene)
            check_speeds(scene)
            scene.frame_set(start)
            simulation = Simulation(context)
            device = solver_device(context, device)
            meta = _make_meta(scene, simulation, cache, start, end, device)
            check_owner(scene, cache, replace_other=replace_other)
            cache.prepare()
            with cache.locked():
                known: dict[int, Frame] = {}
                if resume and cache.exists():
                    known = check_resume(scene, simulation, cache, meta)
                    old = cache.meta()
                    meta = replace(meta, end=max(old.end, end), statistics=old.statistics)
                    cache.write_meta(meta)
                else:
                    cache.begin(meta, simulation.colors)
                    for item in clay_objects(scene):
                        item.data.pop(SCULPTED_MARK, None)
                missing = [frame for frame in range(start, end + 1) if frame not in known]
                if missing:
                    frames = _simulate(simulation, device, cache, meta, known, missing, tally)
                    with closing(frames):
                        for report in frames:
                            if (yield report):
                                cancelled = True
                                break
                    tally.warnings += simulation.warnings()
                    if simulation.edited_clay is not None:
                        _keep_colors(scene, simulation, cache)
                    cache.write_meta(replace(meta, statistics=_statistics(tally, meta)))
        except (SimulationError, WheelError) as error:
            raise BakeError(str(error)) from error
        except ReferenceError as error:
            raise BakeError(
                "Something that is baked was deleted, or replaced by Undo, while the bake ran. The "
                "frames so far are kept; Resume goes on."
            ) from error
        finally:
            # Undo replaces the scene too.
            with suppress(ReferenceError):
                scene.frame_set(previous[0], subframe=previous[1])
    refresh(scene)
    return BakeResult(
        directory=cache.directory,
        start=start,
        end=end,
        baked=tally.written,
        kept=end + 1 - start - len(missing),
        cancelled=cancelled,
        particle_count=meta.particle_count,
        device=device,
        settings=asdict(simulation.settings),
        seconds=time.perf_counter() - began,
        median_frame_milliseconds=1e3 * median(tally.seconds) if tally.seconds else None,
        volume_error=max(tally.volume_errors, key=abs, default=None),
        max_penetration=max(tally.penetrations, default=None),
        overflow=tally.overflow,
        quarantined=tally.quarantined,
        warnings=(*tally.warnings, *_warnings(scene, tally)),
    )


def _keep_colors(scene: bpy.types.Scene, simulation: Simulation, cache: Cache) -> None:
    """Give the clay the colors it has at the end: a bake has one for each particle."""
    assert simulation.edited_clay is not None
    colors = simulation.edited_clay.colors
    cache.write_colors(colors)
    for part, rows in zip(simulation.parts, simulation.parts.split(colors), strict=True):
        write_colors(scene.objects[part.name], rows)


def _make_meta(
    scene: bpy.types.Scene,
    simulation: Simulation,
    cache: Cache,
    start: int,
    end: int,
    device: str,
) -> Meta:
    # Different devices and versions of Warp round differently, so they don't share a bake.
    import warp

    computed_by = f"{device.partition(':')[0]}, Warp {warp.__version__}"
    return Meta(
        start=start,
        end=end,
        frames_per_second=frames_per_second(scene),
        clay=simulation.parts,
        settings={**simulation.digests(), "device": computed_by},
        owner=owner_of(scene, cache),
        version=ADDON_VERSION,
    )


def _simulate(
    simulation: Simulation,
    device: str,
    cache: Cache,
    meta: Meta,
    known: dict[int, Frame],
    missing: list[int],
    tally: _BakeTally,
) -> Generator[BakeProgress, None, None]:
    """Run the solver from the nearest checkpoint to the end, and write what is missing."""
    scene = simulation.scene
    scene.frame_set(meta.start)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    simulation.start(depsgraph, device)
    assert simulation.solver is not None
    last = missing[-1]
    total = len(known) + len(missing)
    at = restore_checkpoint(simulation, cache, meta, missing[0])
    checkpoints = Checkpoints(simulation, cache, meta, at)
    felt = BakeTouch(simulation, cache, meta)
    tally.warnings = felt.warnings
    if missing[0] == meta.start:
        felt.after(meta.start, record=True)
        _write_frame(simulation, cache, meta, meta.start, simulation.feed(depsgraph), tally)
        yield BakeProgress(meta.start, 1, total, None)
    try:
        for number in range(at + 1, last + 1):
            began = time.perf_counter()
            inputs = simulation.advance_to(number, step_solver=True)
            # Before the frame itself, which counts as done once it is there.
            felt.after(number, record=number not in known)
            if number not in known:
                _write_frame(simulation, cache, meta, number, inputs, tally)
            checkpoints.after(number)
            tally.seconds.append(time.perf_counter() - began)
            _note_diagnostics(simulation, tally)
            # The first frame compiles the kernels, so it says nothing of the others.
            pace = tally.seconds[1:]
            left = (last - number) * sum(pace) / len(pace) if pace else None
            yield BakeProgress(number, len(known) + tally.written, total, left)
    except GeneratorExit:
        # Stopped between two frames. After an error, or an interrupt in the middle of a step, the
        # solver's state is not one to resume from.
        checkpoints.close()
        raise
    checkpoints.close()


def _write_frame(
    simulation: Simulation, cache: Cache, meta: Meta, number: int, inputs: bytes, tally: _BakeTally
) -> None:
    positions = simulation.positions()
    bad = int((~np.isfinite(positions).all(1)).sum())
    if bad:
        raise SimulationError(
            f"{bad} particles were no longer finite at frame {number}. The frames before are "
            "kept. Use more substeps."
        )
    cache.write_frame(Frame(number, positions, simulation.velocities(), inputs), meta)
    tally.written += 1


def _note_diagnostics(simulation: Simulation, tally: _BakeTally) -> None:
    assert simulation.solver is not None
    figures = simulation.solver.diagnostics()
    tally.volume_errors.append(figures.volume_error)
    tally.penetrations.append(figures.max_penetration)
    # After edits the solver is built again and counts from 0.
    tally.overflow = max(tally.overflow, figures.overflow)
    tally.quarantined = max(tally.quarantined, figures.quarantined)


def _statistics(tally: _BakeTally, meta: Meta) -> dict[str, float]:
    if not tally.seconds:
        return dict(meta.statistics)
    return {
        "median_frame_milliseconds": 1e3 * median(tally.seconds),
        "volume_error": max(tally.volume_errors, key=abs),
        "max_penetration": max(tally.penetrations),
        "overflow": float(tally.overflow),
        "quarantined": float(tally.quarantined),
    }


def _warnings(scene: bpy.types.Scene, tally: _BakeTally) -> tuple[str, ...]:
    warnings = [
        f"{item.name!r} still plays the frames packed in the .blend; pack again, or unpack, to see "
        "this bake."
        for item in clay_objects(scene)
        if is_packed(item)
    ]
    played = delivered_object(scene)
    if played is not None:
        warnings.append(
            f"{played.name!r} still plays what was delivered before; press Bake to USD again, or "
            "Show Clay Again, to see this bake."
        )
    scale = meters_per_unit(scene)
    pull = to_meters(scene, scene.gravity.length)
    if scene.use_gravity and scale != 1.0 and 0.0 < pull < 1.0:
        warnings.append(
            f"Gravity is only {pull:.2g} m/s² at the scene's unit scale of {scale:g}; the earth's "
            f"is {from_meters(scene, 9.81):.4g} there (Scene > Gravity)."
        )
    if tally.quarantined:
        warnings.append(
            f"Particles were held in place {tally.quarantined} times because their state was not "
            "finite; use more substeps."
        )
    if tally.overflow:
        warnings.append(
            f"{tally.overflow} neighbors of particles found no room in the solver; the clay is "
            "squeezed more than it can follow."
        )
    return tuple(warnings)


def free(
    scene: bpy.types.Scene,
    directory: str | os.PathLike[str] | None = None,
    *,
    replace_other: bool = False,
) -> int:
    """Remove a scene's bake, show the rest state, and return how many bytes that freed.

    Raises:
        BakeError: The bake belongs to another .blend or scene.
        CacheError: The folder cannot be emptied.
    """
    cache = bake_cache(scene, directory)
    check_owner(scene, cache, replace_other=replace_other)
    size = cache.free()
    refresh(scene)
    return size
