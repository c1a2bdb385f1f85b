# SPDX-License-Identifier: GPL-3.0-or-later
"""The clay's frames of a take, at the frame rate of the timeline, written like those of a bake.

If an edit changes the number of particles, the frames before it are written again at the end, with
the final number of particles: each is shown where the nearest particle of that time was.
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
    """Frames with the same particles."""

    cache: Cache
    meta: Meta
    last: int
    shown: NDArray[np.int64]
    """For each particle of the next part, the nearest one of this part."""


class TakeFrames:
    """Turns steps into frames.

    Args:
        writer: Writes them.
        cache: The take's.
        meta: Of its frames.
    """

    def __init__(self, writer: TakeWriter, cache: Cache, meta: Meta) -> None:
        self._writer = writer
        self._cache = self._now = cache
        self._meta = meta
        self._next = meta.start
        self._parts: list[_Part] = []

    def first(self, positions: NDArray[np.float32]) -> None:
        """Write the first frame."""
        self._hand_over(positions, positions, 0.0, 0.0)

    def step(
        self,
        began: float,
        duration: float,
        before: NDArray[np.float32],
        after: NDArray[np.float32],
    ) -> None:
        """Write the frames that lie within a step.

        Args:
            began: When it began [s].
            duration: How long it took [s].
            before: Positions at its start [Blender units], shape [N, 3].
            after: At its end.
        """
        while (share := (self._time(self._next) - began) / duration) <= 1.0 + _EPSILON / duration:
            self._hand_over(before, after, min(max(share, 0.0), 1.0), duration)

    def last(self, seconds: float, positions: NDArray[np.float32]) -> None:
        """Write the last frame, and finish.

        Args:
            seconds: Length of the take [s].
            positions: At its end.
        """
        end = self._meta.start + frame_count(seconds, self._meta.frames_per_second)
        while self._next <= end:
            self._hand_over(positions, positions, 1.0, 0.0)
        self._forget_after(end)
        self.tell_end()
        if self._parts:
            parts, cache, meta = list(self._parts), self._cache, replace(self._meta, end=end)
            now, counted = self._now, self._next
            self._writer.do(lambda: _join(parts, _Part(now, meta, counted, _NONE), cache, meta))

    def rewind(self, seconds: float) -> None:
        """Go back: frames after that time will be written again."""
        after = math.floor((seconds + _EPSILON) * self._meta.frames_per_second) + 1
        self._next = min(self._next, self._meta.start + after)

    def replace(
        self,
        before: NDArray[np.float32],
        after: NDArray[np.float32],
        clay: tuple[ClaySlice, ...],
    ) -> None:
        """Continue with other particles.

        Args:
            before: Positions of the particles so far, shape [N, 3].
            after: Positions of the particles from now on, shape [M, 3].
            clay: The objects that these belong to.
        """
        part = _Part(self._now, self._meta, self._next - 1, nearest(before, after))
        self._parts.append(part)
        self._meta = replace(self._meta, clay=clay)
        self._now = Cache(self._cache.directory / f"part_{len(self._parts):03d}")
        now = self._now
        self._writer.do(now.prepare)

    def tell_end(self) -> None:
        """Write the number of the last frame so far."""
        cache, meta = self._now, replace(self._meta, end=max(self._next - 1, self._meta.start))
        self._writer.do(lambda: cache.write_meta(meta))

    def _time(self, number: int) -> float:
        return (number - self._meta.start) / self._meta.frames_per_second

    def _hand_over(
        self,
        before: NDArray[np.float32],
        after: NDArray[np.float32],
        share: float,
        duration: float,
    ) -> None:
        number, cache, meta = self._next, self._now, self._meta
        self._next += 1

        def write() -> None:
            way = after - before
            velocities = way / np.float32(duration) if duration else np.zeros_like(way)
            frame = Frame(number, before + np.float32(share) * way, velocities)
            # A power cut may lose it; it can be computed again.
            cache.write_frame(frame, meta, lasting=False)

        self._writer.do(write)

    def _forget_after(self, end: int) -> None:
        """Remove frames that were rewound."""
        cache = self._now

        def remove() -> None:
            for number in cache.frames():
                if number > end:
                    cache.frame_path(number).unlink(missing_ok=True)

        self._writer.do(remove)


_NONE = np.zeros(0, np.int64)


def nearest(points: NDArray[np.floating], queries: NDArray[np.floating]) -> NDArray[np.int64]:
    """Index of the point nearest to each query, shape [Q]; there must be at least one point."""
    known = np.asarray(points, np.float64)
    asked = np.asarray(queries, np.float64)
    found = np.full(len(asked), -1)
    extent = float(np.ptp(np.concatenate([known, asked]), axis=0).max())
    size = max(extent / max(len(known), 1) ** (1 / 3), 1e-9)
    while (left := np.flatnonzero(found < 0)).size:
        found[left] = ParticleGrid(known, size).nearest(asked[left])
        size *= 2.0
    return found


def _join(parts: list[_Part], last: _Part, cache: Cache, meta: Meta) -> None:
    """Write the frames of all parts for the particles of the last part."""
    shown = np.arange(meta.particle_count)
    number = last.last - 1
    for part in [last, *reversed(parts)]:
        if part is not last:
            shown = part.shown[shown]
        numbers = [each for each in part.cache.frames() if meta.start <= each <= number]
        for each in numbers:
            try:
                frame = part.cache.read_frame(each, meta=part.meta)
            except CacheError:
                # Of another part, or damaged: the frame will be missing.
                continue
            cache.write_frame(Frame(each, frame.positions[shown], frame.velocities[shown]), meta)
        number = min([number, *(each - 1 for each in numbers)])
    for each in cache.frames():
        if each > meta.end:
            cache.frame_path(each).unlink(missing_ok=True)
    cache.write_meta(meta)
    for part in [last, *parts]:
        if part.cache.directory != cache.directory:
            part.cache.free()
