# SPDX-License-Identifier: GPL-3.0-or-later
"""A simple loop in place of a live session, and the gesture that tests record."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from tactile_clay.clay_addon.base.mesh_geometry import local_from_world, transform
from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.core.tools.edits import Edit
from tactile_clay.clay_addon.model.clay_points import keep_sculpted, write_points
from tactile_clay.clay_addon.model.collider import make_collider
from tactile_clay.clay_addon.sculpt.live.edits import edit_clay
from tactile_clay.clay_addon.simulate.simulation import Simulation
from tactile_clay.clay_addon.take.recorder import TakeRecorder
from tactile_clay.clay_addon.take.store import StoredTake
from tactile_clay.tests.experiments.shapes import ball

STEP = 1.0 / 60.0
TOP = 0.04
"""Height of the block [m]."""


class Loop:
    """Steps and records a scene as a live session does."""

    def __init__(self, scene: Any) -> None:
        self.scene = scene
        self.simulation = Simulation(bpy.context, live=True)
        self.simulation.start(bpy.context.evaluated_depsgraph_get(), "cpu")
        self.recorder = TakeRecorder.begin(scene, self.simulation)
        self.shapes = [self.simulation.positions()]
        """World positions of the clay after each step."""

    def step(self, *, tools: Any = (), duration: float = STEP) -> NDArray[np.float32]:
        """Do one step to the current pose of the scene."""
        depsgraph = bpy.context.evaluated_depsgraph_get()
        self.simulation.update(depsgraph)
        self.recorder.capture(depsgraph, tools)
        assert self.simulation.solver is not None
        self.simulation.solver.step(duration)
        self.shapes.append(self.simulation.positions())
        self.recorder.step(duration, self.shapes[-1], self.simulation.colors)
        return self.shapes[-1]

    def edit(self, *edits: Edit) -> None:
        """Add, remove or paint clay, as a session does between two steps."""
        self.show()
        clay = [self.scene.objects[part.name] for part in self.simulation.parts]
        edit_clay(bpy.context, clay, edits)
        for edit in edits:
            values = asdict(edit)
            self.recorder.edit(values.pop("kind"), values)
        simulation = Simulation(bpy.context, live=True)
        if len(simulation.colors) == len(self.simulation.colors):
            self.simulation.colors = simulation.colors
            return
        self.simulation = simulation
        self.simulation.start(bpy.context.evaluated_depsgraph_get(), "cpu")
        self.recorder.rebuilt(self.simulation)

    def show(self) -> None:
        """Write the clay to Blender and store it, as after a stroke."""
        first = 0
        for part in self.simulation.parts:
            item = self.scene.objects[part.name]
            rows = self.shapes[-1][first : first + part.count]
            write_points(item, transform(local_from_world(item), rows))
            keep_sculpted(item)
            first += part.count

    def finish(self) -> StoredTake:
        """End the session and its take."""
        self.show()
        return self.recorder.finish(self.scene)


def studio_scene(
    studio: Any, folder: Path, *, rate: int, spacing: float = 0.005
) -> tuple[Any, Any]:
    """Make a block of clay on a table, and a ball above it.

    Returns:
        The clay and the ball.
    """
    studio.scene.render.fps = rate
    studio.scene.frame_end = 250
    clay = make_clay(bpy.context, [studio.block(size=TOP, location=(0, 0, TOP / 2))], spacing)
    studio.table()
    shape = ball(0.01)
    mesh = bpy.data.meshes.new("Ball")
    mesh.from_pydata(shape.vertices.tolist(), [], shape.faces.tolist())
    item = bpy.data.objects.new("Ball", mesh)
    studio.scene.collection.objects.link(item)
    item.matrix_world = press(0.0)
    bpy.context.view_layer.update()
    make_collider(item)
    studio.save(folder)
    return clay, item


def press(time: float) -> Matrix:
    """Pose of the ball: down into the block, in an arc through it, rotating, and up again."""
    down = min(time / 0.2, 1.0)
    arc = 4.0 * min(max(time - 0.2, 0.0), 0.3)
    up = max(time - 0.5, 0.0) / 0.1
    place = (
        0.005 * math.sin(arc),
        0.005 * (1.0 - math.cos(arc)),
        TOP + 0.012 - 0.009 * down + 0.03 * up,
    )
    return Matrix.Translation(place) @ Matrix.Rotation(2.0 * time, 4, "Y")


def pressed(time: float) -> bool:
    """Whether the ball touches the clay, which it does until it is lifted off."""
    return time < 0.55


def record_press(loop: Loop, item: Any, seconds: float) -> None:
    """Record the gesture of the ball."""
    for number in range(1, round(seconds / STEP) + 1):
        item.matrix_world = press(number * STEP)
        item.tactile_clay.collider_enabled = pressed(number * STEP)
        loop.step()
