# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of the solver: a bake resumed from one has exactly the same frames."""

from __future__ import annotations

import math

import bpy

from ..core.storage.cache import Cache, CacheError, Meta
from ..simulate.simulation import Simulation

CHECKPOINT_INTERVAL = 10
"""Minimum number of frames between checkpoints."""


class Checkpoints:
    """Writes the solver's state regularly, so that resuming takes little time.

    Args:
        simulation: The running simulation.
        cache: Cache of the bake.
        meta: Metadata of the bake.
        first: Frame at which the simulation starts.
    """

    def __init__(self, simulation: Simulation, cache: Cache, meta: Meta, first: int) -> None:
        self._simulation = simulation
        self._cache = cache
        self._meta = meta
        self._interval = CHECKPOINT_INTERVAL
        self._last = self._reached = first

    def after(self, number: int) -> None:
        """Write a checkpoint after a frame, if one is due."""
        self._reached = number
        if number - self._last >= self._interval:
            self._write()

    def close(self) -> None:
        """Write a checkpoint after the last frame done."""
        if self._reached > self._last:
            self._write()

    def _write(self) -> None:
        snapshot = self._simulation.snapshot()
        size = self._cache.write_checkpoint(self._reached, snapshot, self._meta)
        # Checkpoints should never take more space than the frames.
        frame_size = max(1, 24 * self._meta.particle_count)
        self._interval = max(CHECKPOINT_INTERVAL, math.ceil(size / frame_size))
        self._last = self._reached


def restore_checkpoint(simulation: Simulation, cache: Cache, meta: Meta, first_missing: int) -> int:
    """Restore the last usable checkpoint before the first missing frame, and return its frame."""
    scene = simulation.scene
    for number in reversed(cache.checkpoints()):
        if not meta.start < number < first_missing:
            continue
        try:
            snapshot = cache.read_checkpoint(number, meta=meta)
            scene.frame_set(number)
            simulation.feed(bpy.context.evaluated_depsgraph_get())
            simulation.restore(snapshot)
        except (CacheError, ValueError, KeyError):
            # An earlier checkpoint or the rest state results in the same frames.
            continue
        return number
    scene.frame_set(meta.start)
    simulation.feed(bpy.context.evaluated_depsgraph_get())
    return meta.start
