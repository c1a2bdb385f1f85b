# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake: simulate a scene frame by frame into its cache; stop and resume at any moment."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median

import bpy
import numpy as np

from .cache import Cache, CacheDamagedError, CacheError, Frame, Meta
from .pack import is_packed
from .playback import paused, refresh
from .preferences import ADDON_VERSION
from .properties import frame_range
from .simulation import (
    Simulation,
    SimulationError,
    clay_objects,
    frames_per_second,
    scene_digests,
    solver_device,
)

CHECKPOINT_INTERVAL = 10
"""Fewest frames from one checkpoint to the next."""


class BakeError(Exception):
    """A bake cannot start or go on; the message says why and what to do."""


class BakeStaleError(BakeError):
    """The scene is no longer what the bake was made from."""


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
    """Neighbours that found no free slot in the solver."""
    quarantined: int
    """Times a particle was held because its state was not finite."""
    warnings: tuple[str, ...] = ()
    """What the user should know about the result."""


@dataclass
class _Tally:
    """Figures gathered while baking."""

    written: int = 0
    seconds: list[float] = field(default_factory=list)
    volume_errors: list[float] = field(default_factory=list)
    penetrations: list[float] = field(default_factory=list)
    overflow: int = 0
    quarantined: int = 0


def resolve_directory(scene: bpy.types.Scene, directory: str | os.PathLike[str] | None) -> Path:
    """The cache folder as an absolute path.

    Args:
        scene: Its cache folder is taken where `directory` is None.
        directory: A path; one that starts with ``//`` is beside the .blend.

    Raises:
        BakeError: The folder is relative to a .blend that was never saved, or no folder is set.
    """
    text = os.fspath(directory) if directory is not None else scene.tactile_clay.cache_directory
    if not text:
        raise BakeError("No cache folder is set. Set one in the Bake panel.")
    if text.startswith("//") and not bpy.data.filepath:
        raise BakeError(
            "The .blend was never saved, and its bake goes into a folder beside it. Save the file "
            "first, or set an absolute cache folder."
        )
    return Path(bpy.path.abspath(text)).absolute()


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
    scene = context.scene
    began = time.perf_counter()
    default_start, default_end = frame_range(scene)
    start = default_start if start is None else start
    end = default_end if end is None else end
    if end < start:
        raise BakeError(f"The range ends (frame {end}) before it starts (frame {start}).")
    cache = Cache(resolve_directory(scene, directory))
    previous = scene.frame_current, scene.frame_subframe
    tally = _Tally()
    cancelled = False
    with paused():
        try:
            scene.frame_set(start)
            simulation = Simulation(context)
            device = solver_device(context, device)
            meta = _make_meta(scene, simulation, cache, start, end, device)
            _check_owner(scene, cache, replace_other=replace_other)
            cache.prepare()
            with cache.locked():
                known: dict[int, Frame] = {}
                if resume and cache.exists():
                    known = _check_resume(scene, simulation, cache, meta)
                    old = cache.meta()
                    meta = replace(meta, end=max(old.end, end), statistics=old.statistics)
                    cache.write_meta(meta)
                else:
                    cache.begin(meta, simulation.colors)
                missing = [frame for frame in range(start, end + 1) if frame not in known]
                if missing:
                    frames = _simulate(simulation, device, cache, meta, known, missing, tally)
                    with closing(frames):
                        for report in frames:
                            if (yield report):
                                cancelled = True
                                break
                    cache.write_meta(replace(meta, statistics=_statistics(tally, meta)))
        except SimulationError as error:
            raise BakeError(str(error)) from error
        finally:
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
        warnings=_warnings(scene, tally),
    )


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
        owner=_owner(scene, cache),
        version=ADDON_VERSION,
    )


def _owner(scene: bpy.types.Scene, cache: Cache) -> str:
    """The .blend, seen from the cache folder so that both can move together, and the scene."""
    if not bpy.data.filepath:
        return ""
    try:
        blend = os.path.relpath(bpy.data.filepath, cache.directory)
    except ValueError:
        blend = bpy.data.filepath
    return f"{Path(blend).as_posix()}|{scene.name}"


def _check_owner(scene: bpy.types.Scene, cache: Cache, *, replace_other: bool) -> None:
    """Refuse to touch a bake that another .blend or scene still uses."""
    if replace_other or not cache.exists():
        return
    try:
        owner = cache.meta().owner
    except CacheError:
        return
    blend, _, scene_name = owner.rpartition("|")
    path = cache.directory / blend
    if not blend or not path.exists():
        return
    here = bpy.data.filepath
    same_file = bool(here) and Path(here).exists() and path.samefile(here)
    if same_file and (scene_name == scene.name or scene_name not in bpy.data.scenes):
        return
    raise BakeError(
        f"The cache folder {cache.directory} holds the bake of "
        f"{path.name if not same_file else f'scene {scene_name!r}'}. Choose another cache folder, "
        "so that it is not lost."
    )


def _check_resume(
    scene: bpy.types.Scene, simulation: Simulation, cache: Cache, meta: Meta
) -> dict[int, Frame]:
    """The whole frames to go on from, if the scene is still what it was."""
    try:
        old = cache.meta()
        if old.start != meta.start:
            change = f"it starts at frame {old.start}, not at {meta.start}"
        else:
            change = compare(scene, simulation, cache, meta.settings)
    except CacheDamagedError as error:
        change = f"its meta.json is damaged ({error})"
    if change:
        raise BakeStaleError(
            f"The bake in {cache.directory} is stale: {change}. Bake again to start over, or undo "
            "the change and resume."
        )
    return cache.whole_frames(meta.start, meta.end)


def compare(
    scene: bpy.types.Scene, simulation: Simulation, cache: Cache, settings: Mapping[str, str]
) -> str:
    """What has changed in the scene since it was baked, in words; empty where nothing has.

    Moves the scene through the baked frames, to see what the colliders do there, and leaves it at
    the last one.

    Raises:
        CacheError: There is no bake, or its meta.json is damaged.
        SimulationError: A collider does what the solver cannot follow.
    """
    meta = cache.meta()
    changed = changed_subjects(meta, settings)
    if changed:
        return f"since then changed: {', '.join(changed)}"
    for number, frame in cache.whole_frames(meta.start, meta.end).items():
        scene.frame_set(number)
        if simulation.feed(bpy.context.evaluated_depsgraph_get()) != frame.inputs:
            return f"since then the colliders' motion changed, first at frame {number}"
    return ""


def changed_subjects(meta: Meta, digests: Mapping[str, str]) -> list[str]:
    """Subjects whose digest differs from what the bake was made with."""
    return [name for name, value in digests.items() if meta.settings.get(name) != value]


def changes_at_a_glance(scene: bpy.types.Scene, meta: Meta) -> list[str]:
    """What can be told to have changed without evaluating the colliders, quickly enough to draw."""
    try:
        return changed_subjects(meta, scene_digests(scene))
    except SimulationError as error:
        return [str(error)]


def _simulate(
    simulation: Simulation,
    device: str,
    cache: Cache,
    meta: Meta,
    known: dict[int, Frame],
    missing: list[int],
    tally: _Tally,
) -> Generator[BakeProgress, None, None]:
    """Run the solver from the nearest checkpoint to the end, and write what is missing."""
    scene = simulation.scene
    scene.frame_set(meta.start)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    simulation.start(depsgraph, device)
    assert simulation.solver is not None
    last = missing[-1]
    total = last + 1 - meta.start
    at = _restore(simulation, cache, meta, missing[0])
    checkpoints = _Checkpoints(simulation, cache, meta, at)
    if missing[0] == meta.start:
        _write_frame(simulation, cache, meta, meta.start, simulation.feed(depsgraph), tally)
        yield BakeProgress(meta.start, 1, total, None)
    try:
        for number in range(at + 1, last + 1):
            began = time.perf_counter()
            scene.frame_set(number)
            inputs = simulation.feed(bpy.context.evaluated_depsgraph_get())
            simulation.step()
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


def _restore(simulation: Simulation, cache: Cache, meta: Meta, first_missing: int) -> int:
    """Bring the solver as near to the first missing frame as checkpoints allow."""
    scene = simulation.scene
    assert simulation.solver is not None
    for number in reversed(cache.checkpoints()):
        if not meta.start < number < first_missing:
            continue
        try:
            snapshot = cache.read_checkpoint(number, meta=meta)
            scene.frame_set(number)
            simulation.feed(bpy.context.evaluated_depsgraph_get())
            simulation.solver.restore(snapshot)
        except (CacheError, ValueError, KeyError):
            # An earlier checkpoint, or the rest state, leads to the same frames.
            continue
        return number
    scene.frame_set(meta.start)
    simulation.feed(bpy.context.evaluated_depsgraph_get())
    return meta.start


class _Checkpoints:
    """Writes the solver's state now and then, so that resuming loses little time."""

    def __init__(self, simulation: Simulation, cache: Cache, meta: Meta, at: int) -> None:
        self._simulation = simulation
        self._cache = cache
        self._meta = meta
        self._interval = CHECKPOINT_INTERVAL
        self._last = self._reached = at

    def after(self, number: int) -> None:
        """A frame is done: write a checkpoint if one is due."""
        self._reached = number
        if number - self._last >= self._interval:
            self._write()

    def close(self) -> None:
        """Write one for the last frame that was done."""
        if self._reached > self._last:
            self._write()

    def _write(self) -> None:
        assert self._simulation.solver is not None
        snapshot = self._simulation.solver.snapshot()
        size = self._cache.write_checkpoint(self._reached, snapshot, self._meta)
        # So that the checkpoints never take more room than the frames.
        frame_size = max(1, 24 * self._meta.particle_count)
        self._interval = max(CHECKPOINT_INTERVAL, math.ceil(size / frame_size))
        self._last = self._reached


def _write_frame(
    simulation: Simulation, cache: Cache, meta: Meta, number: int, inputs: bytes, tally: _Tally
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


def _note_diagnostics(simulation: Simulation, tally: _Tally) -> None:
    assert simulation.solver is not None
    figures = simulation.solver.diagnostics()
    tally.volume_errors.append(figures.volume_error)
    tally.penetrations.append(figures.max_penetration)
    tally.overflow = figures.overflow
    tally.quarantined = figures.quarantined


def _statistics(tally: _Tally, meta: Meta) -> dict[str, float]:
    if not tally.seconds:
        return dict(meta.statistics)
    return {
        "median_frame_milliseconds": 1e3 * median(tally.seconds),
        "volume_error": max(tally.volume_errors, key=abs),
        "max_penetration": max(tally.penetrations),
        "overflow": float(tally.overflow),
        "quarantined": float(tally.quarantined),
    }


def _warnings(scene: bpy.types.Scene, tally: _Tally) -> tuple[str, ...]:
    warnings = [
        f"{item.name!r} still plays the frames packed in the .blend; pack again, or unpack, to see "
        "this bake."
        for item in clay_objects(scene)
        if is_packed(item)
    ]
    if tally.quarantined:
        warnings.append(
            f"Particles were held in place {tally.quarantined} times because their state was not "
            "finite; use more substeps."
        )
    if tally.overflow:
        warnings.append(
            f"{tally.overflow} neighbours of particles found no room in the solver; the clay is "
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
    cache = Cache(resolve_directory(scene, directory))
    _check_owner(scene, cache, replace_other=replace_other)
    size = cache.free()
    refresh(scene)
    return size
