# SPDX-License-Identifier: GPL-3.0-or-later
"""The live session: clay that moves under hands and tools while Blender keeps running.

Blender's main thread calls `SculptSession.tick` often. If the solver's thread is idle, the tick
takes its result, updates the poses of hands, colliders and tools, starts the next step, and then
displays the result. Neither thread waits for the other, and only one of them uses the solver at a
time. The session only coordinates; the work is done by `LiveSolver`, `LiveClay`, `LiveTouch`,
`SessionTake`, `UndoStates` and `Autosave`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING

import bpy
import numpy as np
from numpy.typing import NDArray

from ...base.activity import ActivityKind, clay_activity
from ...base.later import later
from ...core.session.frame_budget import FrameBudget
from ...core.session.pace import STEP_SECONDS, Pace
from ...core.session.solver_worker import Stepped
from ...core.session.strokes import StrokeWatch
from ...core.tools.interface import NoTools, Tools
from ...model.clay_points import keep_sculpted
from ...model.clay_scene import SimulationError, solver_device
from ...playback.playback import paused, refresh
from ...simulate.simulation import Simulation
from ...touch.feeling import own_touch
from ...wheel.live import LiveWheels
from .autosave import Autosave
from .checks import SculptError, check_free
from .clay import LiveClay
from .edits import edit_clay
from .solver import LiveSolver
from .take import SessionTake
from .touch import LiveTouch
from .undo import UndoStates, push_undo

if TYPE_CHECKING:
    from ...core.tools.edits import Edit

FAULTS_SHOWN = 5.0
"""How long the panel tells what went wrong [s]."""


class SculptSession:
    """Sculpts the clay of a scene until `finish`.

    Args:
        context: Context with the scene to sculpt.
        tools: The mouse's tools.
        device: ``auto``, ``cpu`` or ``cuda:0``; by default the preferences decide.
        clock: Returns the time of a monotonic clock [s].

    Raises:
        SculptError: The scene cannot be sculpted; nothing has changed.
    """

    def __init__(
        self,
        context: bpy.types.Context,
        *,
        tools: Tools | None = None,
        device: str | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        check_free(context.scene)
        self._scene_uid = context.scene.session_uid
        self.tools: Tools = tools or NoTools()
        self.pace = Pace()
        self.budget = FrameBudget()
        self.undo = UndoStates()
        self.clay = LiveClay(self.budget)
        self.hand_force = 0.0
        """Sum of the magnitudes of the clay's force on each hand [N]."""
        self._clock = clock
        self._strokes = StrokeWatch()
        self._faults: list[str] = []
        self._faults_since = 0.0
        self._undone = False
        self._finished = False
        self._take = SessionTake(wanted=context.scene.tactile_clay.record_take)
        self._touch = LiveTouch()
        refresh(context.scene)
        # What must be cleaned up at the end, even if the session fails to start.
        with ExitStack() as closing:
            try:
                self._solver = LiveSolver(solver_device(context, device))
                closing.callback(self._solver.worker.close)
                self._begin_build(context)
            except SimulationError as error:
                raise SculptError(str(error)) from error
            closing.enter_context(clay_activity.held(ActivityKind.SCULPTING))
            self.autosave = Autosave()
            closing.callback(self.autosave.close)
            closing.callback(self.clay.close_surface)
            self.wheels = LiveWheels(context.scene)
            closing.enter_context(paused())
            closing.enter_context(own_touch())
            self._closing = closing.pop_all()

    # State --------------------------------------------------------------------------------------

    @property
    def simulation(self) -> Simulation:
        """The current simulation."""
        return self._solver.simulation

    @property
    def positions(self) -> NDArray[np.float32]:
        """World positions of all particles as displayed [Blender units], shape [N, 3]."""
        return self.clay.positions

    @property
    def busy(self) -> bool:
        """Whether the solver is busy."""
        return self._solver.worker.busy

    @property
    def factor(self) -> float:
        """Speed of simulated time relative to real time."""
        return self.pace.factor(self._clock())

    @property
    def compiling_seconds(self) -> float:
        """How long the solver has been starting [s]; 0 once the clay moves."""
        if self.pace.started or not self._solver.worker.busy:
            return 0.0
        return time.perf_counter() - self._solver.worker.since

    @property
    def messages(self) -> list[str]:
        """What the user should know, in sentences."""
        said = [*self._take.messages, self._touch.problem, self.autosave.problem, *self._faults]
        return [message for message in said if message]

    def wait(self) -> None:
        """Wait until the solver is idle; call this before anything else uses Warp."""
        self._solver.worker.wait()

    # Each tick ----------------------------------------------------------------------------------

    def tick(self, context: bpy.types.Context) -> bool:
        """Do what is due now, without waiting.

        Returns:
            Whether the display has changed.

        Raises:
            SculptError: The session cannot continue; call `finish`.
        """
        if self._solver.worker.busy:
            return False
        if bpy.app.is_job_running("RENDER"):
            self.pace.pause()
            return False
        try:
            return self._tick(context)
        except SimulationError as error:
            raise SculptError(str(error)) from error

    def _tick(self, context: bpy.types.Context) -> bool:
        # Work deferred by Undo, such as restoring brushes, comes before the clay itself.
        later.run()
        scene = self._scene(context)
        stepped = self._solver.worker.take()
        if self._undone:
            self._restore_undone(context)
            return True
        if self._solver.is_outdated(scene, self.tools):
            # Drop the last step: clay may have been moved or deleted since.
            self._begin_build(context)
            return True
        news = stepped is not None
        if stepped is not None:
            self._read(scene, stepped)
        if self._strokes.has_ended(self._clock(), stroking=self.tools.stroking):
            if stepped is not None:
                self.clay.show(scene, stepped.positions)
            stepped = None
            if self.clay.changed:
                self.keep(scene, "Sculpt Clay")
        edits = self.tools.take_edits()
        if edits:
            if stepped is not None:
                self.clay.show(scene, stepped.positions)
            self._edit(context, edits)
            return True
        duration = self.pace.next(self._clock())
        # A tracked hand then moves at its own speed in simulated time.
        clay_activity.pace = self.factor
        if duration:
            self._begin_step(context, duration)
        # The rest runs in parallel with the solver.
        if stepped is not None:
            self.clay.show(scene, stepped.positions)
        news |= self.clay.show_surface(context)
        if self.clay.changed:
            self.autosave.save_if_due(scene, self._clock())
        return news

    def _begin_step(self, context: bpy.types.Context, duration: float) -> None:
        with self.budget.measured("feed"):
            self.wheels.advance(context.scene, duration)
            try:
                self.simulation.update(context.evaluated_depsgraph_get())
            except SimulationError:
                # A tracked object was deleted or has changed: try to rebuild.
                self._begin_build(context)
                return
            poses = self.tools.poses(duration, self.clay.positions)
            self._solver.place_tools(poses)
            self._take.look(context.evaluated_depsgraph_get(), poses)
        self._solver.begin_step(duration)

    def _edit(self, context: bpy.types.Context, edits: Sequence[Edit]) -> None:
        """Add, remove or paint clay; if the number of particles changes, the next tick rebuilds."""
        scene = context.scene
        clay = [scene.objects[part.name] for part in self.simulation.parts]
        if edit_clay(context, clay, edits):
            self.clay.changed = True
            self._strokes.touched(self._clock())
            self._take.edit(edits)
            if not self._solver.is_outdated(scene, self.tools):
                # Show paint immediately, even on clay that does not move.
                self.clay.offer_surface(scene)

    def _read(self, scene: bpy.types.Scene, stepped: Stepped) -> None:
        """Check and record a step's result and render it as touch, before the next one begins."""
        if not np.isfinite(stepped.positions).all():
            raise SculptError(
                "The simulation became unstable. The clay is as it was after the last stroke. Use "
                "more substeps."
            )
        if not stepped.duration:
            self._take.begin(scene, self.simulation, self.tools.meshes())
            return
        self.pace.took(stepped.duration, stepped.seconds)
        # A step may cover several frames.
        self.budget.took("simulate", stepped.seconds * STEP_SECONDS / stepped.duration)
        self._note_faults()
        world = stepped.positions / np.float32(self.simulation.scale)
        self._take.step(stepped.duration, world)
        with self.budget.measured("touch"):
            self._touch.after(self.simulation, stepped)
        self.hand_force = sum(
            float(np.linalg.norm(part.forces.sum(0))) for part in stepped.contacts
        )
        if self.hand_force or (stepped.tool_force and self.tools.stroking):
            self._strokes.touched(self._clock())

    def _note_faults(self) -> None:
        """Tell what went wrong in the last seconds, as long as that is news."""
        self.simulation.note_faults()
        now = self._clock()
        found = list(self.simulation.faults.sentences())
        if found or now - self._faults_since > FAULTS_SHOWN:
            self._faults, self._faults_since = found, now
        self.simulation.faults.clear()

    # Undo and saving ----------------------------------------------------------------------------

    def keep(self, scene: bpy.types.Scene, message: str) -> None:
        """Push an undo step with the clay as displayed, and make it the starting shape of a bake.

        Args:
            scene: The session's scene.
            message: Name of the undo step.
        """
        for item, _ in self.clay.by_object(scene, self.clay.positions):
            keep_sculpted(item)
        self.undo.keep(scene, self._solver.snapshot(), self._take.mark)
        self.clay.mark_kept()
        push_undo(message)
        self.autosave.begin(scene)

    def before_saving(self, scene: bpy.types.Scene) -> None:
        """Make the clay as displayed the starting shape of a bake, without an undo step."""
        if self.clay.changed:
            self.clay.store(scene)

    def undone(self) -> None:
        """Record that Blender has undone or redone something; the next tick handles it."""
        self._undone = True

    def _restore_undone(self, context: bpy.types.Context) -> None:
        scene = context.scene
        self._undone = self.clay.changed = False
        # Undo has turned the wheels back together with the clay on them.
        self.wheels = LiveWheels(scene)
        self._solver.prepare(context, self.tools)
        self.clay.switch_to(scene, self.simulation)
        self._solver.begin(state=self.undo.state(scene))
        self._take.rewind(self.undo.mark(scene), self.simulation)

    def _begin_build(self, context: bpy.types.Context) -> None:
        """Start rebuilding the solver from the clay as displayed."""
        clay_state = self._solver.prepare(context, self.tools, shown=self.clay.positions)
        self.clay.switch_to(context.scene, self.simulation)
        self._take.rebuilt(self.simulation, self.tools.meshes())
        self._solver.begin(clay_state=clay_state)

    def _scene(self, context: bpy.types.Context) -> bpy.types.Scene:
        scene = context.scene
        if scene is None or scene.session_uid != self._scene_uid:
            raise SculptError("The window now shows another scene. The sculpted clay is kept.")
        return scene

    # The end ------------------------------------------------------------------------------------

    def finish(self, context: bpy.types.Context | None) -> None:
        """End the session and keep the clay as displayed; a second call does nothing.

        Args:
            context: None if Blender's data no longer belongs to this session, as while a file
                loads.
        """
        if self._finished:
            return
        self._finished = True
        scene = None
        try:
            with self._closing:
                # Before the first step there is nothing to keep, so do not wait for compilation.
                if self.pace.started:
                    self._solver.worker.wait()
                # If scene or clay are gone, everything kept so far remains.
                with suppress(SculptError, SimulationError, ReferenceError, KeyError):
                    if context is not None:
                        found = self._scene(context)
                        self._keep_last(found)
                        scene = found
        finally:
            # Whatever fails, the take's thread ends and the take is on disk.
            recorded = self._take.finish(scene)
        if recorded:
            push_undo("Record Take")

    def _keep_last(self, scene: bpy.types.Scene) -> None:
        """Keep the clay as it is after the last step."""
        # The surface is only a stand-in for the clay.
        self.clay.close_surface()
        self.wheels.end(scene)
        stepped = None
        # `tick` is responsible for reporting errors of a step.
        with suppress(Exception):
            stepped = self._solver.worker.take()
        if stepped is not None and np.isfinite(stepped.positions).all():
            self.clay.show(scene, stepped.positions)
        if self._strokes.open or self.clay.has_moved_far():
            self.keep(scene, "Sculpt Clay")
        elif self.clay.changed:
            self.before_saving(scene)
