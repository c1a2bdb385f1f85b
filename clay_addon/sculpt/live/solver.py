# SPDX-License-Identifier: GPL-3.0-or-later
"""The solver of a live session: built from the displayed scene, stepped on its own thread."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING

import bpy
import numpy as np
from numpy.typing import NDArray

from ....solver.core.recording_lock import recording_lock
from ...core.session.solver_worker import SolverWorker, Stepped, step
from ...core.tools.interface import Tools
from ...simulate.simulation import Simulation
from .structure import structure

if TYPE_CHECKING:
    from ....solver import MeshCollider, Scene

_SAME_PLACE = 0.01
"""Clay that moved less than this since the last step keeps its solver state [spacings]."""


class LiveSolver:
    """Owns the simulation of a session, its thread, and the colliders of the tools.

    `prepare` and `begin` build a solver, `begin_step` advances it; ``worker.take`` returns the
    result of either. Only one of them runs at a time, and only then does the thread use the solver.

    Args:
        device: ``cpu`` or ``cuda:0``.
    """

    def __init__(self, device: str) -> None:
        self.worker = SolverWorker()
        self.simulation: Simulation
        """The current simulation; replaced by each `prepare`."""
        self._device = device
        self._structure: Hashable = None
        self._tool_key: Hashable = None
        self._colliders: list[MeshCollider] = []
        self._prepared: Scene

    def is_outdated(self, scene: bpy.types.Scene, tools: Tools) -> bool:
        """Whether the scene or the tool has changed such that the solver must be rebuilt."""
        return structure(scene) != self._structure or tools.mesh_key != self._tool_key

    def prepare(
        self,
        context: bpy.types.Context,
        tools: Tools,
        *,
        shown: NDArray[np.float32] | None = None,
    ) -> dict[str, NDArray] | None:
        """Read the clay as displayed, and everything it collides with; call `begin` next.

        Args:
            context: Context with the session's scene.
            tools: The mouse's tools.
            shown: World positions of all particles after the last step [Blender units], shape
                [N, 3], if their solver state should be kept when possible.

        Returns:
            The solver state of the clay so far; None if it does not apply to the clay now.

        Raises:
            SimulationError: The scene cannot be simulated.
        """
        before = self.simulation if self._structure else None
        self._structure = structure(context.scene)
        self._tool_key = tools.mesh_key
        self.simulation = Simulation(context, live=True)
        self._prepared = self.simulation.prepare(context.evaluated_depsgraph_get())
        self._colliders = []
        for mesh in tools.meshes():
            collider = self._prepared.add_mesh(mesh.vertices, mesh.faces, friction=mesh.friction)
            collider.set_enabled(False)
            self._colliders.append(collider)
        if before is None or shown is None:
            return None
        return self._reusable_clay_state(before, shown)

    def begin(
        self,
        *,
        state: dict[str, NDArray] | None = None,
        clay_state: dict[str, NDArray] | None = None,
    ) -> None:
        """Start building the prepared solver.

        Args:
            state: A complete solver state to restore, if it still fits.
            clay_state: Otherwise, a state from which only the clay is restored.
        """
        simulation, prepared, device = self.simulation, self._prepared, self._device

        def build() -> Stepped:
            from ...core.surface.quick.surface import load_kernels

            with recording_lock:
                load_kernels()
            simulation.build(prepared, device)
            assert simulation.solver is not None
            if state is not None:
                try:
                    simulation.restore(state)
                except (KeyError, ValueError):
                    # Colliders have been added or removed since.
                    with suppress(ValueError):
                        simulation.solver.restore_clay(state)
            elif clay_state is not None:
                with suppress(ValueError):
                    simulation.solver.restore_clay(clay_state)
            return step(simulation.solver, 0.0, (), ())

        self.worker.begin(build)

    def place_tools(self, poses: Sequence[tuple[NDArray[np.float64], bool]]) -> None:
        """Set the poses of the tools at the end of the next step.

        Args:
            poses: For each tool, the matrix from its coordinates to the world [m], shape [4, 4],
                and whether it acts on the clay.
        """
        for collider, (pose, enabled) in zip(self._colliders, poses, strict=True):
            collider.set_pose(pose)
            collider.set_enabled(enabled)

    def begin_step(self, duration: float) -> None:
        """Start a step of some duration [s], after hands, colliders and tools were placed."""
        solver = self.simulation.solver
        assert solver is not None
        hands = [hand.handle for hand in self.simulation.hands if hand.handle is not None]
        self.worker.begin(partial(step, solver, duration, hands, self._colliders))

    def snapshot(self) -> dict[str, NDArray] | None:
        """The solver's state; None while it is busy or not built yet."""
        if self.simulation.solver is None or self.worker.busy:
            return None
        return self.simulation.snapshot()

    def _reusable_clay_state(
        self, before: Simulation, shown: NDArray[np.float32]
    ) -> dict[str, NDArray] | None:
        """The solver's state if the clay is unchanged and only tools or colliders have changed.

        This preserves cuts and stress when the tool changes: a solver that is built from points
        alone bonds everything that is close together.
        """
        if before.solver is None or self.worker.busy:
            return None
        after = self.simulation
        clay = [(each.parts, each.materials, each.spacing, each.scale) for each in (before, after)]
        if clay[0] != clay[1]:
            return None
        rest = np.concatenate(after.rest)
        if float(np.abs(rest - shown).max(initial=0.0)) > _SAME_PLACE * after.spacing:
            return None
        return before.solver.snapshot()
