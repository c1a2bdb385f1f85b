# SPDX-License-Identifier: GPL-3.0-or-later
"""Ultrasound touch for the hands of a live session."""

from __future__ import annotations

from numpy.typing import NDArray

from ...core.session.solver_worker import Stepped
from ...simulate.simulation import Simulation
from ...touch.array import TouchArrayError
from ...touch.connection import touch
from ...touch.feeling import ghost_weights


class LiveTouch:
    """Sends the contacts of each step to the array, if the scene has an array and hands."""

    def __init__(self) -> None:
        self._simulation: Simulation | None = None
        self._weights: list[NDArray | None] = []
        self._since: float | None = None
        self.problem = ""
        """The latest problem, as a sentence; empty if there was none."""

    def after(self, simulation: Simulation, stepped: Stepped) -> None:
        """Render the contacts of a step as touch."""
        if not stepped.contacts or simulation.scene.tactile_touch.array is None:
            return
        if simulation is not self._simulation:
            self._weights, warnings = ghost_weights(simulation)
            self.problem = " ".join(warnings)
            self._simulation, self._since = simulation, None
        try:
            touch.touch_frame(
                simulation.scene, stepped.contacts, weights=self._weights, dt=self._since
            )
        except TouchArrayError as error:
            self.problem = str(error)
            return
        self._since = stepped.duration
