# SPDX-License-Identifier: GPL-3.0-or-later
"""Playing a bake: which of its frames is shown at a frame, and the particles of each object."""

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
    """World positions [Blender units], shape [N, 3], of each object."""
    velocities: list[NDArray[np.float32]]
    """World velocities [Blender units/s], shape [N, 3], of each object."""


def held_frame(number: int, *, first: int, hold: int) -> int:
    """The frame whose shape is shown at another one, where each shape is held for some frames.

    Args:
        number: The frame at which it is shown.
        first: The first frame of the bake.
        hold: Number of frames that a shape is held.
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
        """What the bake was made from; its file is read again only when it has changed.

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
        """Numbers of the baked frames, sorted; empty where there is no bake."""
        return self.cache.frames()

    def frame(self, number: int) -> PlayedFrame:
        """Read a baked frame.

        Args:
            number: Number of the baked frame; see `shown_frame`.

        Raises:
            CacheMissingError: The frame, or the bake, is missing.
            CacheDamagedError: It is damaged.
        """
        meta = self.meta()
        frame = self.cache.read_frame(number, meta=meta)
        layout = meta.layout
        return PlayedFrame(number, layout.split(frame.positions), layout.split(frame.velocities))


def shown_frame(frames: list[int], number: int, *, hold: int) -> int:
    """The baked frame that is shown at a frame.

    Before the first baked frame that is the first, and after the last the last. It may be missing
    in the bake.

    Args:
        frames: Numbers of the baked frames, sorted.
        number: The frame at which it is shown.
        hold: Number of frames that a shape is held.

    Raises:
        CacheMissingError: There are no frames.
    """
    if not frames:
        raise CacheMissingError("there are no baked frames")
    first, last = frames[0], frames[-1]
    return held_frame(min(max(number, first), last), first=first, hold=hold)
