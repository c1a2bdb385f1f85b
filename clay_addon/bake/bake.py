# SPDX-License-Identifier: GPL-3.0-or-later
"""Baking a scene frame by frame into its cache; a bake can be stopped and resumed at any time."""

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
from ..base.clock import go_to, shown_moment
from ..base.preferences import ADDON_VERSION
from ..base.units import from_meters, meters_per_unit, to_meters
from ..core.storage.cache import Cache, Frame, Meta
from ..core.storage.playback import MAX_FRAME, NO_SUCH_FRAME
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
    """Progress of a bake."""

    frame: int
    """The frame just finished."""
    done: int
    """Number of frames done, out of `total`."""
    total: int
    """Number of frames in the range."""
    seconds_left: float | None
    """Estimated remaining time [s]; None while unknown."""


@dataclass(frozen=True)
class BakeResult:
    """Result and statistics of a bake."""

    directory: Path
    """The cache folder."""
    start: int
    """First frame of the range."""
    end: int
    """Last frame of the range."""
    baked: int
    """Number of frames simulated and written."""
    kept: int
    """Number of frames that already existed."""
    cancelled: bool
    """Whether the bake was stopped before the end; its frames are kept."""
    particle_count: int
    """Number of particles."""
    device: str
    """Device of the computation."""
    settings: dict[str, object]
    """Settings of the solver."""
    seconds: float
    """Duration of the bake [s]."""
    median_frame_milliseconds: float | None
    """Median simulation time of a frame [ms]; None if no frame was simulated."""
    volume_error: float | None
    """Largest mean compression of the clay in any frame, as a fraction."""
    max_penetration: float | None
    """Largest depth of a particle inside a collider [m]."""
    overflow: int
    """Number of neighbors without a free slot in the solver."""
    quarantined: int
    """Number of times a particle was held because its state was not finite."""
    warnings: tuple[str, ...] = ()
    """Warnings about the result for the user."""


@dataclass
class _BakeTally:
    """Statistics collected during a bake."""

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
        context: Its scene is baked; the current frame is restored afterward.
        start: First frame, the rest state; by default from the scene's settings.
        end: Last frame; by default from the scene's settings.
        directory: Cache folder; by default from the scene's settings.
        resume: Whether to keep existing frames and continue at the first missing one.
        device: ``auto``, ``cpu`` or ``cuda:0``; by default from the preferences.
        replace_other: Whether to overwrite a cache that belongs to another .blend or scene.
        progress: Called after each frame; the bake stops if it returns False.

    Raises:
        BakeStaleError: With `resume`, the scene has changed since the bake.
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
    """Bake as `bake` does, in a generator that yields after each frame.

    Sending True or closing the generator stops the bake; the frames so far are kept, with a
    checkpoint to resume from. The scene's current frame is restored in any case.
    """
    try:
        clay_activity.check_free()
    except BusyError as error:
        raise BakeError(str(error)) from error
    frames = _bake_frames(context, start, end, directory, resume, device, replace_other)
    return (yield from clay_activity.run_steps(ActivityKind.BAKE, frames))


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
    for number in (start, end):
        if abs(number) > MAX_FRAME:
            raise BakeError(NO_SUCH_FRAME.format(number))
    cache = bake_cache(scene, directory)
    # Account for changes to the points since the last change of frame.
    refresh(scene)
    previous = shown_moment(scene)
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
                    simulation.measure_hands(context.evaluated_depsgraph_get())
                    tally.warnings += simulation.warnings()
                    if simulation.edited_clay is not None:
                        _keep_colors(scene, simulation, cache)
                    cache.write_meta(replace(meta, statistics=_statistics(tally, meta)))
        except (SimulationError, WheelError) as error:
            raise BakeError(str(error)) from error
        except ReferenceError as error:
            raise BakeError(
                "An object in the bake was deleted, or replaced by Undo, during the bake. The "
                "frames so far are kept; Resume continues."
            ) from error
        finally:
            # Undo replaces the scene too.
            with suppress(ReferenceError):
                go_to(scene, previous)
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
    """Store the final colors of the clay: a bake has one color per particle for all frames."""
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
    # Devices and Warp versions differ in rounding, so they do not share a bake.
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
    """Run the solver from the nearest checkpoint to the end, and write the missing frames."""
    scene = simulation.scene
    scene.frame_set(meta.start)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    simulation.start(depsgraph, device)
    assert simulation.solver is not None
    last = missing[-1]
    total = len(known) + len(missing)
    at = restore_checkpoint(simulation, cache, meta, missing[0])
    checkpoints = Checkpoints(simulation, cache, meta, at)
    touch = BakeTouch(simulation, cache, meta)
    tally.warnings = touch.warnings
    if missing[0] == meta.start:
        touch.after(meta.start, record=True)
        _write_frame(simulation, cache, meta, meta.start, simulation.feed(depsgraph), tally)
        yield BakeProgress(meta.start, 1, total, None)
    try:
        for number in range(at + 1, last + 1):
            began = time.perf_counter()
            inputs = simulation.advance_to(number, step_solver=True)
            # Before the frame itself, which counts as done once its file exists.
            touch.after(number, record=number not in known)
            if number not in known:
                _write_frame(simulation, cache, meta, number, inputs, tally)
            checkpoints.after(number)
            tally.seconds.append(time.perf_counter() - began)
            _note_diagnostics(simulation, tally)
            # The first frame is not representative, since it compiles the kernels.
            durations = tally.seconds[1:]
            left = (last - number) * sum(durations) / len(durations) if durations else None
            yield BakeProgress(number, len(known) + tally.written, total, left)
    except GeneratorExit:
        # Stopped between two frames. After an error, or an interrupt in the middle of a step, no
        # checkpoint is written, because the solver's state may be invalid.
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
            f"{bad} particles were no longer finite at frame {number}. Earlier frames are kept. "
            "Use more substeps."
        )
    cache.write_frame(Frame(number, positions, simulation.velocities(), inputs), meta)
    tally.written += 1


def _note_diagnostics(simulation: Simulation, tally: _BakeTally) -> None:
    assert simulation.solver is not None
    diagnostics = simulation.solver.diagnostics()
    tally.volume_errors.append(diagnostics.volume_error)
    tally.penetrations.append(diagnostics.max_penetration)
    # After edits the solver is rebuilt and counts from 0 again.
    tally.overflow = max(tally.overflow, diagnostics.overflow)
    tally.quarantined = max(tally.quarantined, diagnostics.quarantined)


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
        f"{item.name!r} still plays the frames packed in the .blend; pack again or unpack to see "
        "this bake."
        for item in clay_objects(scene)
        if is_packed(item)
    ]
    played = delivered_object(scene)
    if played is not None:
        warnings.append(
            f"{played.name!r} still plays the files delivered before; press Bake to USD again or "
            "Show Clay Again to see this bake."
        )
    scale = meters_per_unit(scene)
    gravity = to_meters(scene, scene.gravity.length)
    if scene.use_gravity and scale != 1.0 and 0.0 < gravity < 1.0:
        warnings.append(
            f"Gravity is only {gravity:.2g} m/s² at the scene's unit scale of {scale:g}; set it to "
            f"{from_meters(scene, 9.81):.4g} for Earth's gravity (Scene > Gravity)."
        )
    return tuple(warnings)


def free(
    scene: bpy.types.Scene,
    directory: str | os.PathLike[str] | None = None,
    *,
    replace_other: bool = False,
) -> int:
    """Remove a scene's bake, show the rest state, and return the size of the bake [bytes].

    Raises:
        BakeError: The bake belongs to another .blend or scene.
        CacheError: The folder cannot be emptied.
    """
    cache = bake_cache(scene, directory)
    check_owner(scene, cache, replace_other=replace_other)
    size = cache.free()
    refresh(scene)
    return size
