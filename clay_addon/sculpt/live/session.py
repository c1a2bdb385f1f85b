# SPDX-License-Identifier: GPL-3.0-or-later
"""The live session: clay that moves under hands and tools while Blender keeps running.

Blender's main thread calls `SculptSession.tick` often. When the solver's thread is idle, the tick
takes its result, tells the solver where everything is by now, lets it take the next step, and then
shows the result. Neither thread waits for the other, and only one of them uses the solver at a
time. The session holds the order of things; its parts do them: `LiveSolver`, `LiveClay`,
`LiveTouch`, `SessionTake`, `UndoStates` and `Autosave`.
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


class SculptSession:
    """Sculpts the clay of a scene until `finish`.

    Args:
        context: Its scene is sculpted.
        tools: What the mouse holds.
        device: ``auto``, ``cpu`` or ``cuda:0``; the preferences' where not given.
        clock: Seconds of a steady clock.

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
        self.felt = 0.0
        """Force of the clay on the hands [N]."""
        self._clock = clock
        self._strokes = StrokeWatch()
        self._undone = False
        self._finished = False
        self._take = SessionTake(wanted=context.scene.tactile_clay.record_take)
        self._touch = LiveTouch()
        refresh(context.scene)
        # What must be undone at the end, also if the session cannot even start.
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

    # What others ask ----------------------------------------------------------------------------

    @property
    def simulation(self) -> Simulation:
        """What is simulated now."""
        return self._solver.simulation

    @property
    def positions(self) -> NDArray[np.float32]:
        """All particles as shown, world [Blender units], shape [N, 3]."""
        return self.clay.positions

    @property
    def busy(self) -> bool:
        """Whether the solver is at work."""
        return self._solver.worker.busy

    @property
    def factor(self) -> float:
        """Simulated time over real time."""
        return self.pace.factor(self._clock())

    @property
    def compiling_seconds(self) -> float:
        """How long the solver has been getting ready [s]; 0 once the clay moves."""
        if self.pace.started or not self._solver.worker.busy:
            return 0.0
        return time.perf_counter() - self._solver.worker.since

    @property
    def messages(self) -> list[str]:
        """What the user should know, in sentences."""
        said = [*self._take.messages, self._touch.problem, self.autosave.problem]
        return [message for message in said if message]

    def wait(self) -> None:
        """Wait until the solver is idle: call it before anything else uses Warp."""
        self._solver.worker.wait()

    # Each tick ----------------------------------------------------------------------------------

    def tick(self, context: bpy.types.Context) -> bool:
        """Do what is due now; never wait.

        Returns:
            Whether something new is shown.

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
        # What Undo left to do about stand-ins and brushes comes before the clay itself.
        later.run()
        scene = self._scene(context)
        stepped = self._solver.worker.take()
        if self._undone:
            self._take_up_undo(context)
            return True
        if self._solver.is_outdated(scene, self.tools):
            # The last step is dropped: clay may have been moved or deleted since.
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
        if duration:
            self._begin_step(context, duration)
        # The rest is done while the solver works.
        if stepped is not None:
            self.clay.show(scene, stepped.positions)
        news |= self.clay.show_surface(context)
        if self.clay.changed:
            self.autosave.now_and_then(scene, self._clock())
        return news

    def _begin_step(self, context: bpy.types.Context, duration: float) -> None:
        with self.budget.measured("feed"):
            self.wheels.advance(context.scene, duration)
            try:
                self.simulation.update(context.evaluated_depsgraph_get())
            except SimulationError:
                # Something that was followed is gone or has changed: try to build again.
                self._begin_build(context)
                return
            poses = self.tools.poses(duration, self.clay.positions)
            self._solver.place_tools(poses)
            self._take.look(context.evaluated_depsgraph_get(), poses)
        self._solver.begin_step(duration)

    def _edit(self, context: bpy.types.Context, edits: Sequence[Edit]) -> None:
        """Add, remove or paint clay; if particles came or went, the next tick builds a solver."""
        scene = context.scene
        clay = [scene.objects[part.name] for part in self.simulation.parts]
        if edit_clay(context, clay, edits):
            self.clay.changed = True
            self._strokes.touched(self._clock())
            self._take.edit(edits)
            if not self._solver.is_outdated(scene, self.tools):
                # Paint shows at once, also on clay that does not move.
                self.clay.offer_surface(scene)

    def _read(self, scene: bpy.types.Scene, stepped: Stepped) -> None:
        """Check, record and feel the result of a step before the next one begins."""
        if not np.isfinite(stepped.positions).all():
            raise SculptError(
                "The simulation became unstable. The clay is as it was after the last stroke; use "
                "more substeps."
            )
        if not stepped.duration:
            self._take.begin(scene, self.simulation, self.tools.meshes())
            return
        self.pace.took(stepped.duration, stepped.seconds)
        # A step may cover several frames.
        self.budget.took("simulate", stepped.seconds * STEP_SECONDS / stepped.duration)
        world = stepped.positions / np.float32(self.simulation.scale)
        self._take.step(stepped.duration, world)
        with self.budget.measured("touch"):
            self._touch.after(self.simulation, stepped)
        self.felt = sum(float(np.linalg.norm(part.forces.sum(0))) for part in stepped.contacts)
        if self.felt or (stepped.tool_force and self.tools.stroking):
            self._strokes.touched(self._clock())

    # Undo and saving ----------------------------------------------------------------------------

    def keep(self, scene: bpy.types.Scene, message: str) -> None:
        """Make an undo step of the clay as shown, and let a bake start from it.

        Args:
            scene: The session's.
            message: Name of the undo step.
        """
        for item, _ in self.clay.by_object(scene, self.clay.positions):
            keep_sculpted(item)
        self.undo.keep(scene, self._solver.snapshot(), self._take.mark)
        self.clay.mark_kept()
        push_undo(message)
        self.autosave.begin(scene)

    def before_saving(self, scene: bpy.types.Scene) -> None:
        """Let a bake of the saved file start from the clay as shown, without an undo step."""
        if self.clay.changed:
            self.clay.store(scene)

    def undone(self) -> None:
        """Note that Blender has undone or redone something: the next tick takes it up."""
        self._undone = True

    def _take_up_undo(self, context: bpy.types.Context) -> None:
        scene = context.scene
        self._undone = self.clay.changed = False
        # Undo turned the wheels back together with the clay on them.
        self.wheels = LiveWheels(scene)
        self._solver.prepare(context, self.tools)
        self.clay.take_up(scene, self.simulation)
        self._solver.begin(state=self.undo.state(scene))
        self._take.rewind(self.undo.mark(scene), self.simulation)

    def _begin_build(self, context: bpy.types.Context) -> None:
        """Build the solver again from the clay as Blender shows it."""
        clay_state = self._solver.prepare(context, self.tools, shown=self.clay.positions)
        self.clay.take_up(context.scene, self.simulation)
        self._take.rebuilt(self.simulation, self.tools.meshes())
        self._solver.begin(clay_state=clay_state)

    def _scene(self, context: bpy.types.Context) -> bpy.types.Scene:
        scene = context.scene
        if scene is None or scene.session_uid != self._scene_uid:
            raise SculptError("The window shows another scene now. What was sculpted is kept.")
        return scene

    # The end ------------------------------------------------------------------------------------

    def finish(self, context: bpy.types.Context | None) -> None:
        """End the session and keep the clay as shown; a second call does nothing.

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
                # Kernels that are still being compiled are not waited for: nothing was done yet.
                if self.pace.started:
                    self._solver.worker.wait()
                # If what was sculpted is gone, all that was kept before stays.
                with suppress(SculptError, SimulationError, ReferenceError, KeyError):
                    if context is not None:
                        found = self._scene(context)
                        self._keep_last(found)
                        scene = found
        finally:
            # Whatever went wrong, the take's thread ends, and the take is on the disk.
            recorded = self._take.finish(scene)
        if recorded:
            push_undo("Record Take")

    def _keep_last(self, scene: bpy.types.Scene) -> None:
        """Keep the clay as the last step left it."""
        # The surface is only a stand-in for the clay.
        self.clay.close_surface()
        self.wheels.end(scene)
        stepped = None
        # `tick` reports what went wrong in the last step.
        with suppress(Exception):
            stepped = self._solver.worker.take()
        if stepped is not None and np.isfinite(stepped.positions).all():
            self.clay.show(scene, stepped.positions)
        if self._strokes.open or self.clay.has_moved_far():
            self.keep(scene, "Sculpt Clay")
        elif self.clay.changed:
            self.before_saving(scene)
