# SPDX-License-Identifier: GPL-3.0-or-later
"""Records focal points with the bake, and sends them during playback without simulating.

The cache has a file such as ``foci_000001.npz`` for each frame. Its positions are in world space
and Blender units, like everything else in the cache, and its pressures in pascals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..base.app_handlers import add_handlers, remove_handlers
from ..base.units import meters_per_unit
from ..core.storage.cache import Cache, CacheError, Meta
from ..core.storage.foci import FociFrame, read_foci, write_foci
from ..playback.playback import cache_of
from .array import TouchArrayError
from .connection import touch

if TYPE_CHECKING:
    from ...haptics.foci.pipeline import TouchFrame


def record_touch(cache: Cache, number: int, frame: TouchFrame, meta: Meta, *, scale: float) -> None:
    """Record the focal points of a frame of the bake.

    Args:
        cache: The bake's cache.
        number: Number of the frame.
        frame: The frame.
        meta: The bake's metadata.
        scale: Meters per Blender unit.

    Raises:
        CacheError: The folder cannot be written to.
    """
    foci = frame.foci
    positions = np.asarray(foci.positions, np.float32) / np.float32(scale)
    pressures = np.asarray(foci.pressures, np.float32)
    write_foci(cache.directory, FociFrame(number, positions, pressures, foci.sigma), meta)


def recorded_touch(cache: Cache, number: int, *, scale: float) -> TouchFrame:
    """The focal points recorded at a frame of the bake.

    Args:
        cache: The bake's cache.
        number: Number of the frame.
        scale: Meters per Blender unit.

    Raises:
        CacheError: Nothing was recorded at this frame, or the file is damaged.
    """
    from ...haptics import Foci
    from ...haptics.foci.pipeline import TouchFrame

    recorded = read_foci(cache.directory, number, cache.meta())
    positions = recorded.positions.astype(np.float64) * scale
    pressures = recorded.pressures.astype(np.float64)
    # The field that the foci were fitted to is not recorded.
    assignment = np.zeros(0, np.intp)
    return TouchFrame(Foci(positions, pressures, assignment, recorded.sigma))


class TouchReplay:
    """State of the replay of recorded touch."""

    def __init__(self) -> None:
        self.paused = False
        """Set while a live session or a bake computes its own touch."""


replay = TouchReplay()
"""One for the process, because Blender calls its handlers without any state."""


@persistent
def _send_frame(scene: bpy.types.Scene, *_: object) -> None:
    """Send the focal points recorded at the current frame."""
    properties = scene.tactile_touch
    if replay.paused or not properties.play_baked or properties.array is None:
        return
    # A render runs in a separate thread, and not in real time.
    if bpy.app.is_job_running("RENDER"):
        return
    if touch.client is None and not properties.show_overlay:
        return
    cache = cache_of(scene)
    if cache is None:
        return
    try:
        frame = recorded_touch(cache, scene.frame_current, scale=meters_per_unit(scene))
    except CacheError:
        touch.show(None)
        return
    try:
        touch.send(scene, frame)
    except TouchArrayError:
        # The error is reported at the next connection.
        touch.show(frame)


def register() -> None:
    """Follow changes of the current frame."""
    add_handlers((("frame_change_post", _send_frame),))


def unregister() -> None:
    """Stop following them."""
    remove_handlers((("frame_change_post", _send_frame),))
