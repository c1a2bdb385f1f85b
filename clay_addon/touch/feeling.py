# SPDX-License-Identifier: GPL-3.0-or-later
"""Touch of a bake, recorded with it frame by frame, and perceptual weights of its hands."""

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
    """Pause the replay of recorded touch inside the context, and reset touch at both ends."""
    replay.paused = True
    touch.rest()
    try:
        yield
    finally:
        touch.rest()
        replay.paused = False


class BakeTouch:
    """Records the touch of each frame of a bake, if the scene has an array and hands.

    Args:
        simulation: The running simulation, at its first frame.
        cache: The bake's cache.
        meta: The bake's metadata.
    """

    def __init__(self, simulation: Simulation, cache: Cache, meta: Meta) -> None:
        self._simulation = simulation
        self._cache = cache
        self._meta = meta
        self._time_step: float | None = None
        self.warnings: list[str] = []
        """Messages for the user."""
        self._enabled = bool(simulation.hands) and self._has_array()
        self._weights: list[NDArray | None] = []
        if self._enabled:
            self._weights, warnings = ghost_weights(simulation)
            self.warnings += warnings

    def after(self, number: int, *, record: bool) -> None:
        """Compute and record the touch of a simulated frame.

        Args:
            number: Number of the frame.
            record: Whether to record it; the frame affects the following frames either way.

        Raises:
            CacheError: The folder cannot be written to.
        """
        if not self._enabled:
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
            self._disable(error, f" from frame {number} on")
            return
        self._time_step = simulation.time_step
        if frame is not None and record:
            record_touch(self._cache, number, frame, self._meta, scale=simulation.scale)

    def _has_array(self) -> bool:
        try:
            return placed_array(self._simulation.scene) is not None
        except TouchArrayError as error:
            self._disable(error, "")
            return False

    def _disable(self, error: TouchArrayError, when: str) -> None:
        self._enabled = False
        self.warnings.append(f"No touch was recorded with the bake{when}: {error}")


def ghost_weights(simulation: Simulation) -> tuple[list[NDArray | None], list[str]]:
    """Perceptual weights of the ghosts of each hand, according to the scene's setting.

    Returns:
        Weights of each hand's ghosts, None for equal weights, and warnings for the user.
    """
    from ...haptics.skin.sensitivity import SkinSensitivity

    all_weights: list[NDArray | None] = []
    warnings: list[str] = []
    if not simulation.scene.tactile_touch.use_weights:
        return all_weights, warnings
    for hand in simulation.hands:
        try:
            weights = SkinSensitivity.of(hand.rig).ghosts
        except ValueError as error:
            warnings.append(
                f"Touch treats all skin of {hand.item.name!r} as equally sensitive: {error}"
            )
            all_weights.append(None)
            continue
        # The solver's contacts contain only the ghosts on the surface.
        all_weights.append(weights[hand.rig.ghost_areas > 0.0])
    return all_weights, warnings
