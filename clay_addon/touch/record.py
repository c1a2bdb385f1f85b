# SPDX-License-Identifier: GPL-3.0-or-later
"""Focal points recorded with the bake, and felt again while it plays, without simulating.

The cache keeps ``foci_000001.npz`` beside each frame: positions in world space and Blender units,
as all else there, and pressures in pascals.
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
    """Keep what was felt at a frame of the bake.

    Args:
        cache: The bake's cache.
        number: Number of the frame.
        frame: What was felt.
        meta: The bake's.
        scale: Meters in a Blender unit.

    Raises:
        CacheError: The folder cannot be written to.
    """
    foci = frame.foci
    positions = np.asarray(foci.positions, np.float32) / np.float32(scale)
    pressures = np.asarray(foci.pressures, np.float32)
    write_foci(cache.directory, FociFrame(number, positions, pressures, foci.sigma), meta)


def recorded_touch(cache: Cache, number: int, *, scale: float) -> TouchFrame:
    """What was felt at a frame of the bake.

    Args:
        cache: The bake's cache.
        number: Number of the frame.
        scale: Meters in a Blender unit.

    Raises:
        CacheError: Nothing was recorded there, or it is damaged.
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
    """Whether what was recorded is felt while the bake plays."""

    def __init__(self) -> None:
        self.paused = False
        """Set while a live session or a bake feels for itself."""


replay = TouchReplay()
"""One for the process, since Blender calls its handlers without any state."""


@persistent
def _feel_frame(scene: bpy.types.Scene, *_: object) -> None:
    """Feel what was recorded at the frame that is shown now."""
    properties = scene.tactile_touch
    if replay.paused or not properties.play_baked or properties.array is None:
        return
    # A render goes by in a thread of its own, and not in time.
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
        touch.feel(scene, frame)
    except TouchArrayError:
        # The panel says so at the next connection.
        touch.show(frame)


def register() -> None:
    """Follow the frames."""
    add_handlers((("frame_change_post", _feel_frame),))


def unregister() -> None:
    """Follow them no more."""
    remove_handlers((("frame_change_post", _feel_frame),))
