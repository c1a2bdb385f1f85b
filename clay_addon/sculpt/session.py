# SPDX-License-Identifier: GPL-3.0-or-later
"""The live session: clay that moves under hands and tools while Blender goes on.

Blender's main thread calls `SculptSession.tick` often. When the worker is idle, that takes what it
came to, tells the solver where everything is by now, lets it step on, and shows what it took. So
nobody waits for anybody, and only one of both touches the solver at any time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.recording_lock import recording_lock
from ..base.activity import ActivityKind, clay_activity
from ..base.mesh_geometry import local_from_world, transform
from ..core.session.frame_budget import FrameBudget
from ..core.session.pace import STEP_SECONDS, Pace
from ..core.session.solver_worker import SolverWorker, Stepped, step
from ..core.tools.interface import NoTools, Tools
from ..model.clay_points import keep_sculpted, write_points
from ..model.clay_scene import (
    SimulationError,
    clay_colors,
    clay_objects,
    read_points,
    solver_device,
)
from ..playback.playback import paused, refresh
from ..simulate.simulation import Simulation
from ..touch.bake_touch import own_touch
from ..wheel.live import LiveWheels
from .autosave import Autosave
from .clay_edits import edit_clay
from .live_surface import LiveSurface
from .live_touch import LiveTouch
from .session_checks import SculptError, check_free
from .session_take import SessionTake
from .structure import structure
from .undo_states import UndoStates

if TYPE_CHECKING:
    from ...solver import MeshCollider
    from ..core.tools.edits import Edit

_SETTLE_SECONDS = 0.4
"""Hands that have let go of the clay for this long have ended a stroke [s]."""
_MOVED = 0.02
"""Clay that moved less than this is as it was, in spacings."""
_FAR = 0.5
"""Clay that nobody touched is worth an undo step from this on, in spacings: it springs back a
little after each stroke."""


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
        self._clock = clock
        self._worker = SolverWorker()
        self.simulation: Simulation
        self._structure: Hashable = None
        self._tool_key: Hashable = None
        self._colliders: list[MeshCollider] = []
        self._taken_back = False
        self._changed = False
        self._stroking = False
        self._touched_at: float | None = None
        self.positions = np.zeros((0, 3), np.float32)
        """Where all particles are seen, world [Blender units], shape [N, 3]."""
        self._kept = self.positions
        self.felt = 0.0
        """Force of the clay on the hands [N]."""
        self._closing = ExitStack()
        self._surface: LiveSurface | None = None
        self._take = SessionTake(wanted=context.scene.tactile_clay.record_take)
        refresh(context.scene)
        try:
            self._device = solver_device(context, device)
            self._begin_build(context)
        except SimulationError as error:
            self._worker.close()
            raise SculptError(str(error)) from error
        self.autosave = Autosave()
        self.wheels = LiveWheels(context.scene)
        self._touch = LiveTouch()
        self._closing.enter_context(paused())
        self._closing.enter_context(own_touch())

    # What others ask ----------------------------------------------------------------------------

    @property
    def busy(self) -> bool:
        """Whether the solver is at work."""
        return self._worker.busy

    @property
    def factor(self) -> float:
        """Simulated time over that of the clock."""
        return self.pace.factor(self._clock())

    @property
    def compiling_seconds(self) -> float:
        """How long the solver has been getting ready [s]; 0 once the clay moves."""
        if self.pace.started or not self._worker.busy:
            return 0.0
        return time.perf_counter() - self._worker.since

    @property
    def messages(self) -> list[str]:
        """What a person should know, in sentences."""
        said = [*self._take.messages, self._touch.problem, self.autosave.problem]
        return [message for message in said if message]

    @property
    def spacing(self) -> float:
        """Distance between particles [Blender units]."""
        return self.simulation.spacing

    def wait(self) -> None:
        """Wait until the solver has nothing to do: before anything else uses Warp."""
        self._worker.wait()

    # Each tick ----------------------------------------------------------------------------------

    def tick(self, context: bpy.types.Context) -> bool:
        """Do what is to be done now, and never wait.

        Returns:
            Whether something new is shown.

        Raises:
            SculptError: The session cannot go on; call `finish`.
        """
        if self._worker.busy:
            return False
        if bpy.app.is_job_running("RENDER"):
            self.pace.pause()
            return False
        try:
            return self._tick(context)
        except SimulationError as error:
            raise SculptError(str(error)) from error

    def _tick(self, context: bpy.types.Context) -> bool:
        scene = self._scene(context)
        stepped = self._worker.take()
        if self._taken_back:
            self._take_back(context)
            return True
        if self._is_other(scene):
            # What the solver came to is let go: clay may have been moved, or be gone.
            self._begin_build(context)
            return True
        news = stepped is not None
        if stepped is not None:
            self._look_at(scene, stepped)
        if self._has_stroke_ended():
            if stepped is not None:
                self._show(scene, stepped)
            stepped = None
            if self._changed:
                self.keep(scene, "Sculpt Clay")
        edits = self.tools.take_edits()
        if edits:
            if stepped is not None:
                self._show(scene, stepped)
            self._edit(context, edits)
            return True
        duration = self.pace.next(self._clock())
        if duration:
            self._begin_step(context, duration)
        # The rest is done while the solver works.
        if stepped is not None:
            self._show(scene, stepped)
        if self._surface is None:
            self._open_surface(context)
        else:
            began = time.perf_counter()
            if self._surface.show():
                self.budget.took("surface", time.perf_counter() - began)
                news = True
        if self._changed:
            self.autosave.now_and_then(scene, self._clock())
        return news

    def _begin_step(self, context: bpy.types.Context, duration: float) -> None:
        with self.budget.measured("feed"):
            self.wheels.advance(context.scene, duration)
            try:
                self.simulation.follow(context.evaluated_depsgraph_get())
            except SimulationError:
                # What was fed is gone or not what it was: see whether it can be taken up anew.
                self._begin_build(context)
                return
            poses = self.tools.poses(duration)
            for collider, (pose, enabled) in zip(self._colliders, poses, strict=True):
                collider.set_pose(pose)
                collider.set_enabled(enabled)
            self._take.look(context.evaluated_depsgraph_get(), poses)
        solver = self.simulation.solver
        assert solver is not None
        hands = [hand.handle for hand in self.simulation.hands if hand.handle is not None]
        self._worker.begin(partial(step, solver, duration, hands, self._colliders))

    def _edit(self, context: bpy.types.Context, edits: Sequence[Edit]) -> None:
        """Add clay, take some away or paint it; a solver is built where particles came or went."""
        scene = context.scene
        clay = [scene.objects[part.name] for part in self.simulation.parts]
        if edit_clay(context, clay, edits):
            self._changed = True
            self._touched_at = self._clock()
            self._take.edit(edits)
            if not self._is_other(scene):
                # Paint shows at once, also on clay that does not move.
                self._offer_surface(scene)

    def _look_at(self, scene: bpy.types.Scene, stepped: Stepped) -> None:
        """See what a step came to, before the next one."""
        if not np.isfinite(stepped.positions).all():
            raise SculptError(
                "Clay was no longer finite. The clay is as it was after the last stroke; use more "
                "substeps."
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
            self._touched_at = self._clock()

    def _show(self, scene: bpy.types.Scene, stepped: Stepped) -> None:
        """Write the newest positions into the point clouds."""
        with self.budget.measured("write"):
            world = stepped.positions / np.float32(self.simulation.scale)
            # Clay that sleeps does not move a bit: Blender need not draw it anew.
            if np.array_equal(self.positions, world):
                return
            self.positions = world
            if not self._changed:
                self._changed = self._moved() > _MOVED * self.spacing
            for item, positions in self.by_object(scene, world):
                write_points(item, transform(local_from_world(item), positions))
        self._offer_surface(scene)

    def _offer_surface(self, scene: bpy.types.Scene) -> None:
        """Have a surface made of what is shown."""
        if self._surface is not None:
            parts = self.by_object(scene, self.positions)
            self._surface.offer([(points, clay_colors(item)) for item, points in parts])

    def _moved(self) -> float:
        """How far any clay has come since the last undo step [Blender units]."""
        return float(np.abs(self.positions - self._kept).max(initial=0.0))

    def by_object(
        self, scene: bpy.types.Scene, values: NDArray[np.float32]
    ) -> Iterator[tuple[bpy.types.Object, NDArray[np.float32]]]:
        """Rows of all particles, with the object whose they are."""
        first = 0
        for part in self.simulation.parts:
            yield scene.objects[part.name], values[first : first + part.count]
            first += part.count

    # Strokes and Undo ---------------------------------------------------------------------------

    def _has_stroke_ended(self) -> bool:
        """Whether the mouse has let go of the clay just now, or the hands have."""
        ended = self._stroking and not self.tools.stroking
        self._stroking = self.tools.stroking
        if self._touched_at is None or self._stroking:
            return False
        if ended or self._clock() - self._touched_at > _SETTLE_SECONDS:
            self._touched_at = None
            return True
        return False

    def keep(self, scene: bpy.types.Scene, message: str) -> None:
        """Make what is shown an undo step, and what a bake starts from.

        Args:
            scene: The session's.
            message: Name of the undo step.
        """
        for part in self.simulation.parts:
            keep_sculpted(scene.objects[part.name])
        state = None
        if self.simulation.solver is not None and not self._worker.busy:
            state = self.simulation.snapshot()
        self.undo.keep(scene, state, self._take.mark)
        self._kept = self.positions
        self._changed = False
        push_undo(message)
        self.autosave.begin(scene)

    def before_saving(self, scene: bpy.types.Scene) -> None:
        """Let what is shown be what a bake of the file starts from, without an undo step."""
        for part in self.simulation.parts:
            item = scene.objects.get(part.name)
            if item is not None and self._changed:
                keep_sculpted(item)

    def undone(self) -> None:
        """Blender has undone or redone something: take up what it came to at the next tick."""
        self._taken_back = True

    def _take_back(self, context: bpy.types.Context) -> None:
        scene = context.scene
        self._taken_back = self._changed = False
        # They stand as they did then, and so does the clay on them.
        self.wheels = LiveWheels(scene)
        self._begin_build(context, state=self.undo.state(scene), goes_on=False)
        self._take.rewind(self.undo.mark(scene), self.simulation)

    # Building -----------------------------------------------------------------------------------

    def _is_other(self, scene: bpy.types.Scene) -> bool:
        return structure(scene) != self._structure or self.tools.mesh_key != self._tool_key

    def _begin_build(
        self,
        context: bpy.types.Context,
        *,
        state: dict[str, NDArray] | None = None,
        goes_on: bool = True,
    ) -> None:
        """Build the solver from the clay as Blender shows it.

        Args:
            context: Its scene is the session's.
            state: A state of the solver to take up, where that still fits.
            goes_on: Whether this is what comes next, and not what was before.
        """
        before = self.simulation if self._structure else None
        self._structure = structure(context.scene)
        self._tool_key = self.tools.mesh_key
        self.simulation = simulation = Simulation(context, live=True)
        prepared = simulation.prepare(context.evaluated_depsgraph_get())
        self._colliders = []
        for mesh in self.tools.meshes():
            collider = prepared.add_mesh(mesh.vertices, mesh.faces, friction=mesh.friction)
            collider.set_enabled(False)
            self._colliders.append(collider)
        carried = None
        if state is None and goes_on and before is not None:
            carried = self._carried(before, simulation)
        self.positions = self._kept = np.concatenate(simulation.rest)

        if goes_on:
            self._take.rebuilt(simulation, self.tools.meshes())
        if self._surface is not None:
            if before is None or before.parts != simulation.parts:
                self._close_surface()
            else:
                self._offer_surface(context.scene)

        def build() -> Stepped:
            from ..core.surface.quick.surface import load_kernels

            with recording_lock:
                load_kernels()
            simulation.build(prepared, self._device)
            assert simulation.solver is not None
            if state is not None:
                try:
                    simulation.restore(state)
                except (KeyError, ValueError):
                    # Colliders came or went since.
                    with suppress(ValueError):
                        simulation.solver.restore_clay(state)
            elif carried is not None:
                with suppress(ValueError):
                    simulation.solver.restore_clay(carried)
            return step(simulation.solver, 0.0, (), ())

        self._worker.begin(build)

    def _carried(self, before: Simulation, after: Simulation) -> dict[str, NDArray] | None:
        """The solver's state where the clay is the same, and only what works it is not.

        Cuts stay open and clay stays tense when another tool is taken. A solver that is built from
        points alone bonds whatever lies close.
        """
        if before.solver is None or self._worker.busy:
            return None
        clay = [(each.parts, each.materials, each.spacing, each.scale) for each in (before, after)]
        if clay[0] != clay[1]:
            return None
        rest = np.concatenate(after.rest)
        if float(np.abs(rest - self.positions).max(initial=0.0)) > 0.01 * after.spacing:
            return None
        return before.solver.snapshot()

    # The surface --------------------------------------------------------------------------------

    def _open_surface(self, context: bpy.types.Context) -> None:
        clay = [context.scene.objects[part.name] for part in self.simulation.parts]
        self._surface = LiveSurface(context, clay)
        self._offer_surface(context.scene)

    def _close_surface(self) -> None:
        surface, self._surface = self._surface, None
        if surface is not None:
            surface.close()

    def _scene(self, context: bpy.types.Context) -> bpy.types.Scene:
        scene = context.scene
        if scene is None or scene.session_uid != self._scene_uid:
            raise SculptError("Another scene was chosen. What was sculpted is kept.")
        return scene

    # The end ------------------------------------------------------------------------------------

    def finish(self, context: bpy.types.Context | None) -> None:
        """End the session and keep what is shown; a second call does nothing.

        Args:
            context: None where Blender's data is no longer this session's, as while a file loads.
        """
        with self._closing:
            # Kernels that are being compiled are not waited for: nothing was done yet.
            if self.pace.started:
                self._worker.wait()
            scene = None
            try:
                scene = self._scene(context) if context is not None else None
                if scene is not None:
                    # What is kept is the clay itself, and not what stands for it.
                    self._close_surface()
                    self.wheels.end(scene)
                    stepped = None
                    # What went wrong in the last step is told by `tick`.
                    with suppress(Exception):
                        stepped = self._worker.take()
                    if stepped is not None and np.isfinite(stepped.positions).all():
                        self._show(scene, stepped)
                    if self._touched_at is not None or self._moved() > _FAR * self.spacing:
                        self.keep(scene, "Sculpt Clay")
                    elif self._changed:
                        self.before_saving(scene)
            except (SculptError, SimulationError, ReferenceError, KeyError):
                # What it was about is gone; what was kept before stays.
                scene = None
            finally:
                self._close_surface()
                self._worker.close()
                self.autosave.close()
        if self._take.finish(scene):
            push_undo("Record Take")


current: SculptSession | None = None
"""The session that runs; None while there is none."""


first: dict[str, tuple[NDArray, NDArray]] = {}
"""Points and colours of each clay object, by name, as the last session found them."""


def start(context: bpy.types.Context, tools: Tools | None = None) -> SculptSession:
    """Start the session of a scene.

    Raises:
        SculptError: One runs already, or the scene cannot be sculpted.
    """
    global current, first
    if current is not None:
        raise SculptError("Sculpting goes on already. Press Esc or Finish to end it.")
    current = SculptSession(context, tools=tools)
    clay_activity.begin(ActivityKind.SCULPTING)
    first = clay_state(context.scene)
    return current


def stop(context: bpy.types.Context | None) -> None:
    """End the session that runs, if one does, and keep what is shown.

    Args:
        context: None where Blender's data is no longer the session's.
    """
    global current
    ended, current = current, None
    if ended is not None:
        clay_activity.end()
        ended.finish(context)


def clay_state(scene: bpy.types.Scene) -> dict[str, tuple[NDArray, NDArray]]:
    """Local positions and colours of each clay object, by name."""
    state = {}
    for item in clay_objects(scene):
        local = read_points(item, "position")
        if local is not None:
            state[item.name] = (local, clay_colors(item))
    return state


def push_undo(message: str) -> None:
    """Make an undo step of what Blender holds now, where there is a window and so an Undo."""
    if not bpy.app.background and bpy.ops.ed.undo_push.poll():
        bpy.ops.ed.undo_push(message=message)
