# SPDX-License-Identifier: GPL-3.0-or-later
"""Playback of a bake: the baked frame shown at a scene frame, and the particles of each object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .cache import Cache, CacheMissingError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .meta import Meta


MAX_FRAME = 1_048_574
"""Blender clamps frame numbers beyond it without a word; as many are negative."""
NO_SUCH_FRAME = f"Blender has no frame {{:,}}: they go from {-MAX_FRAME:,} to {MAX_FRAME:,}."


@dataclass(frozen=True)
class PlayedFrame:
    """The particles of each clay object at a baked frame."""

    number: int
    """Number of the baked frame."""
    positions: list[NDArray[np.float32]]
    """World positions of each object [Blender units], shape [N, 3]."""
    velocities: list[NDArray[np.float32]]
    """World velocities of each object [Blender units/s], shape [N, 3]."""


def held_frame(number: int, *, first: int, hold: int) -> int:
    """The baked frame shown at a scene frame if each shape is held for several frames.

    Args:
        number: The scene frame.
        first: First frame of the bake.
        hold: Number of frames each shape is held.
    """
    return first + (number - first) // hold * hold


class Playback:
    """Plays the bake in a cache folder.

    Example:
        >>> playback = Playback(Cache("clay_cache"))
        >>> for points, name in zip(playback.frame(12).positions, playback.meta().layout.names):
        ...     print(name, points.mean(0))

    Args:
        cache: The cache folder.
    """

    def __init__(self, cache: Cache) -> None:
        self.cache = cache
        self._known: tuple[int, Meta] | None = None

    def meta(self) -> Meta:
        """Metadata of the bake; the file is read again only if it has changed.

        Raises:
            CacheError: There is no bake, or its ``meta.json`` is damaged.
        """
        try:
            stamp = (self.cache.directory / "meta.json").stat().st_mtime_ns
        except OSError:
            return self.cache.meta()
        if self._known is None or self._known[0] != stamp:
            self._known = stamp, self.cache.meta()
        return self._known[1]

    def frames(self) -> list[int]:
        """Sorted numbers of the baked frames; empty if there is no bake."""
        return self.cache.frames()

    def frame(self, number: int) -> PlayedFrame:
        """Read a baked frame.

        Args:
            number: Number of the baked frame; see `shown_frame`.

        Raises:
            CacheMissingError: The frame, or the bake, is missing.
            CacheDamagedError: A file is damaged.
        """
        meta = self.meta()
        frame = self.cache.read_frame(number, meta=meta)
        layout = meta.layout
        return PlayedFrame(number, layout.split(frame.positions), layout.split(frame.velocities))


def shown_frame(frames: list[int], number: int, *, hold: int) -> int:
    """The baked frame shown at a scene frame, between the first and last baked frame.

    The bake may lack this frame.

    Args:
        frames: Sorted numbers of the baked frames.
        number: The scene frame.
        hold: Number of frames each shape is held.

    Raises:
        CacheMissingError: There are no frames.
    """
    if not frames:
        raise CacheMissingError("there are no baked frames")
    first, last = frames[0], frames[-1]
    return held_frame(min(max(number, first), last), first=first, hold=hold)
