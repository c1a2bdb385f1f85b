# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of the clay in a take, at the frame rate of the scene, in the format of a bake.

If an edit changes the number of particles, the earlier frames are rewritten at the end with the
final number of particles: each is shown at the nearest particle of that time.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..storage.cache import Cache, CacheError, ClaySlice, Frame, Meta
from ..surface.particle_grid import ParticleGrid
from .data import frame_count
from .writer import TakeWriter

_EPSILON = 1e-9
"""Times closer than this count as the same [s]."""


class _Part(NamedTuple):
    """Consecutive frames with the same particles."""

    cache: Cache
    meta: Meta
    last: int
    """Number of the last frame."""
    nearest: NDArray[np.int64]
    """Index of the nearest particle of this part to each particle of the next one."""


class TakeFrames:
    """Interpolates steps to frames and writes them.

    Args:
        writer: Thread that writes the frames.
        cache: Cache of the take.
        meta: Metadata of the frames.
    """

    def __init__(self, writer: TakeWriter, cache: Cache, meta: Meta) -> None:
        self._writer = writer
        self._cache = self._current = cache
        self._meta = meta
        self._next = meta.start
        self._parts: list[_Part] = []

    def first(self, positions: NDArray[np.float32]) -> None:
        """Write the first frame."""
        self._write_frame(positions, positions, 0.0, 0.0)

    def step(
        self,
        began: float,
        duration: float,
        before: NDArray[np.float32],
        after: NDArray[np.float32],
    ) -> None:
        """Write the frames that lie within a step.

        Args:
            began: Time at its start [s].
            duration: Duration [s].
            before: Positions at its start [Blender units], shape [N, 3].
            after: Positions at its end [Blender units], shape [N, 3].
        """
        limit = 1.0 + _EPSILON / duration
        while (fraction := (self._time(self._next) - began) / duration) <= limit:
            self._write_frame(before, after, min(max(fraction, 0.0), 1.0), duration)

    def last(self, seconds: float, positions: NDArray[np.float32]) -> None:
        """Write the remaining frames and finish.

        Args:
            seconds: Length of the take [s].
            positions: Positions at its end [Blender units], shape [N, 3].
        """
        end = self._meta.start + frame_count(seconds, self._meta.frames_per_second)
        while self._next <= end:
            self._write_frame(positions, positions, 1.0, 0.0)
        self._remove_after(end)
        self.write_end()
        if self._parts:
            parts, cache, meta = list(self._parts), self._cache, replace(self._meta, end=end)
            last = _Part(self._current, meta, self._next, np.zeros(0, np.int64))
            self._writer.do(lambda: _join(parts, last, cache, meta))

    def rewind(self, seconds: float) -> None:
        """Go back to a time [s]; later frames will be overwritten."""
        after = math.floor((seconds + _EPSILON) * self._meta.frames_per_second) + 1
        self._next = min(self._next, self._meta.start + after)

    def replace(
        self,
        before: NDArray[np.float32],
        after: NDArray[np.float32],
        clay: tuple[ClaySlice, ...],
    ) -> None:
        """Continue with a new set of particles.

        Args:
            before: Positions of the old particles [Blender units], shape [N, 3].
            after: Positions of the new particles [Blender units], shape [M, 3].
            clay: Clay objects of the new particles.
        """
        part = _Part(self._current, self._meta, self._next - 1, nearest(before, after))
        self._parts.append(part)
        self._meta = replace(self._meta, clay=clay)
        self._current = Cache(self._cache.directory / f"part_{len(self._parts):03d}")
        self._writer.do(self._current.prepare)

    def write_end(self) -> None:
        """Write the number of the last frame so far to ``meta.json``."""
        cache, meta = self._current, replace(self._meta, end=max(self._next - 1, self._meta.start))
        self._writer.do(lambda: cache.write_meta(meta))

    def _time(self, number: int) -> float:
        return (number - self._meta.start) / self._meta.frames_per_second

    def _write_frame(
        self,
        before: NDArray[np.float32],
        after: NDArray[np.float32],
        fraction: float,
        duration: float,
    ) -> None:
        number, cache, meta = self._next, self._current, self._meta
        self._next += 1

        def write() -> None:
            displacement = after - before
            velocities = np.zeros_like(displacement)
            if duration:
                velocities = displacement / np.float32(duration)
            frame = Frame(number, before + np.float32(fraction) * displacement, velocities)
            # A frame lost in a power failure can be computed again.
            cache.write_frame(frame, meta, durable=False)

        self._writer.do(write)

    def _remove_after(self, end: int) -> None:
        """Remove frames after the end, which are left over from before a rewind."""
        cache = self._current

        def remove() -> None:
            for number in cache.frames():
                if number > end:
                    cache.frame_path(number).unlink(missing_ok=True)

        self._writer.do(remove)


def nearest(points: NDArray[np.floating], queries: NDArray[np.floating]) -> NDArray[np.int64]:
    """Index of the point nearest to each query, shape [Q]; `points` must not be empty."""
    known = np.asarray(points, np.float64)
    targets = np.asarray(queries, np.float64)
    found = np.full(len(targets), -1)
    extent = float(np.ptp(np.concatenate([known, targets]), axis=0).max())
    size = max(extent / max(len(known), 1) ** (1 / 3), 1e-9)
    while (left := np.flatnonzero(found < 0)).size:
        found[left] = ParticleGrid(known, size).nearest(targets[left])
        size *= 2.0
    return found


def _join(parts: list[_Part], last: _Part, cache: Cache, meta: Meta) -> None:
    """Write the frames of all parts with the particles of the last part."""
    indices = np.arange(meta.particle_count)
    end = last.last - 1
    for part in [last, *reversed(parts)]:
        if part is not last:
            indices = part.nearest[indices]
        numbers = [number for number in part.cache.frames() if meta.start <= number <= end]
        for number in numbers:
            try:
                frame = part.cache.read_frame(number, meta=part.meta)
            except CacheError:
                # Belongs to another part, or is damaged: the frame will be missing.
                continue
            positions, velocities = frame.positions[indices], frame.velocities[indices]
            cache.write_frame(Frame(number, positions, velocities), meta)
        end = min([end, *(number - 1 for number in numbers)])
    for number in cache.frames():
        if number > meta.end:
            cache.frame_path(number).unlink(missing_ok=True)
    cache.write_meta(meta)
    for part in [last, *parts]:
        if part.cache.directory != cache.directory:
            part.cache.free()
