# SPDX-License-Identifier: GPL-3.0-or-later
"""What the hands of a bake would be let feel: recorded with it, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from numpy.typing import NDArray

from ..core.storage.cache import Cache, Meta
from ..simulate.simulation import Simulation
from .array import TouchArrayError, placed_array
from .connection import touch
from .record import record_touch, replay


@contextmanager
def own_touch() -> Iterator[None]:
    """Leave what was recorded alone inside the context, and forget what was felt before."""
    replay.paused = True
    touch.rest()
    try:
        yield
    finally:
        touch.rest()
        replay.paused = False


class BakeTouch:
    """Records what is felt at each frame, where the scene has an array and hands.

    Args:
        simulation: Running, at its first frame.
        cache: The bake's cache.
        meta: The bake's.
    """

    def __init__(self, simulation: Simulation, cache: Cache, meta: Meta) -> None:
        self._simulation = simulation
        self._cache = cache
        self._meta = meta
        self._time_step: float | None = None
        self.warnings: list[str] = []
        """What the user should know of it."""
        self._on = bool(simulation.hands) and self._has_array()
        self._weights: list[NDArray | None] = []
        if self._on:
            self._weights, warnings = ghost_weights(simulation)
            self.warnings += warnings

    def after(self, number: int, *, record: bool) -> None:
        """A frame is simulated: let it be felt, and record it.

        Args:
            number: Number of the frame.
            record: Whether to keep it; it decides what the next frames feel like either way.

        Raises:
            CacheError: The folder cannot be written to.
        """
        if not self._on:
            return
        simulation = self._simulation
        assert simulation.solver is not None
        contacts = [
            simulation.solver.contacts(hand.handle)
            for hand in simulation.hands
            if hand.handle is not None
        ]
        try:
            frame = touch.touch_frame(
                simulation.scene,
                contacts,
                weights=self._weights,
                dt=self._time_step,
                send=False,
            )
        except TouchArrayError as error:
            self._stop(error, f" from frame {number} on")
            return
        self._time_step = simulation.time_step
        if frame is not None and record:
            record_touch(self._cache, number, frame, self._meta, scale=simulation.scale)

    def _has_array(self) -> bool:
        try:
            return placed_array(self._simulation.scene) is not None
        except TouchArrayError as error:
            self._stop(error, "")
            return False

    def _stop(self, error: TouchArrayError, when: str) -> None:
        self._on = False
        self.warnings.append(f"No touch was recorded with the bake{when}: {error}")


def ghost_weights(simulation: Simulation) -> tuple[list[NDArray | None], list[str]]:
    """How much touch counts on each ghost of each hand, by the scene's setting.

    Returns:
        Perceptual weights of each hand's ghosts, and what the user should know of them.
    """
    from ...haptics.skin.sensitivity import SkinSensitivity

    found: list[NDArray | None] = []
    warnings: list[str] = []
    if not simulation.scene.tactile_touch.use_weights:
        return found, warnings
    for hand in simulation.hands:
        try:
            weights = SkinSensitivity.of(hand.rig).ghosts
        except ValueError as error:
            warnings.append(f"All skin of {hand.item.name!r} counts the same for touch: {error}")
            found.append(None)
            continue
        # Ghosts inside the hand feel nothing.
        found.append(weights[hand.rig.ghost_areas > 0.0])
    return found, warnings
