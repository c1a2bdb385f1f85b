# SPDX-License-Identifier: GPL-3.0-or-later
"""Breakdown of a live sculpting frame's time, by number of particles.

A soft hand, or a ball instead of the mouse, presses a block on a table in a session without a
window, with a simulated ultrasound array. Run in its own process, because it needs bpy:
``python -m tactile_clay.tests.experiments.frame_budget``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

SPACINGS = (0.005, 0.004, 0.0023, 0.00136)
"""Particle spacings [m]: about 2,000, 4,000, 20,000 and 100,000 particles."""
BLOCK = 0.063
"""Edge of the block [m]."""
_PARTS = ("simulate", "feed", "touch", "write", "surface", "evaluate")


@dataclass(frozen=True)
class FrameCost:
    """Median times of a frame's parts [ms]."""

    particle_count: int
    worker: str
    """What presses the clay."""
    simulate: float
    """Solver step of 1/60 s, on its own thread."""
    feed: float
    """Passing the poses of hands and colliders to the solver."""
    touch: float
    """Computing focal points from the contacts on the hand."""
    write: float
    """Writing the points into Blender."""
    surface: float
    """Live surface: time on Blender's thread."""
    making: float
    """Live surface: reconstruction, on its own thread."""
    evaluate: float
    """Blender's evaluation of the changes, without drawing."""


class Ball:
    """A ball of 12 mm radius that moves up and down."""

    mesh_key = "ball"
    stroking = True

    def __init__(self, top: float) -> None:
        self._top = top
        self._time = 0.0

    def meshes(self) -> list[Any]:
        """Return the ball's mesh."""
        from tactile_clay.clay_addon.core.tools.settings import ToolMesh

        ball = trimesh.creation.icosphere(3, 0.012)
        return [ToolMesh(np.asarray(ball.vertices), np.asarray(ball.faces, np.int32))]

    def poses(
        self, duration: float, positions: NDArray[np.float32]
    ) -> list[tuple[NDArray[np.float64], bool]]:
        """Move down by a centimeter and up again each second."""
        self._time += duration
        pose = np.eye(4)
        pose[2, 3] = self._top + 0.012 - 0.005 * (1.0 - np.cos(2.0 * np.pi * self._time))
        return [(pose, True)]

    def take_edits(self) -> list[Any]:
        """Return no edits."""
        return []


def measure(spacing: float, *, hand: bool, seconds: float = 1.5) -> FrameCost:
    """Sculpt for some simulated time in this process's Blender."""
    import bpy

    from tactile_clay.clay_addon.clay.make_clay import make_clay
    from tactile_clay.clay_addon.hands.add_hand import add_hand
    from tactile_clay.clay_addon.model.collider import make_collider
    from tactile_clay.clay_addon.sculpt.live.current import current
    from tactile_clay.clay_addon.touch.array import add_array

    bpy.ops.wm.read_factory_settings(use_empty=True)
    context = bpy.context
    bpy.ops.mesh.primitive_cube_add(size=BLOCK, location=(0.0, 0.0, 0.5 * BLOCK))
    clay = make_clay(context, [context.object], spacing, "plasticine")
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    make_collider(context.object)
    item = None
    if hand:
        # The palm is centered over the block, flat and just above it.
        item = add_hand(context, "right").parent
        add_array(context, "sonicsurface")
        context.view_layer.update()
        item.location.z += BLOCK + 0.02 - _lowest(context, item)
    running = current.start(context, None if hand else Ball(BLOCK))
    if item is not None:
        top = item.location.z
    while running.pace.simulated < seconds:
        running.wait()
        if item is not None:
            item.location.z = top - 0.015 * (1.0 - np.cos(2.0 * np.pi * running.pace.simulated))
        if running.tick(context):
            began = time.perf_counter()
            context.view_layer.update()
            running.budget.took("evaluate", time.perf_counter() - began)
    found = running.budget.milliseconds()
    surface = running.clay.surface
    making = 1e3 * surface.seconds if surface else 0.0
    count = len(clay.data.points)
    current.stop(context)
    times = {part: found.get(part, 0.0) for part in _PARTS}
    return FrameCost(count, "hand" if hand else "ball", making=making, **times)


def _lowest(context: Any, armature: Any) -> float:
    """Height of the lowest point of a hand's skin [m]."""
    from tactile_clay.clay_addon.base.mesh_geometry import evaluated_mesh, transform

    skin = armature.children[0]
    depsgraph = context.evaluated_depsgraph_get()
    vertices, _ = evaluated_mesh(skin, depsgraph)
    return float(transform(np.array(skin.matrix_world), vertices)[:, 2].min())


def budget_lines() -> list[str]:
    """Measure in a separate process, and return lines of Markdown."""
    command = [sys.executable, "-m", "tactile_clay.tests.experiments.frame_budget"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = [FrameCost(**row) for row in json.loads(done.stdout.splitlines()[-1])]
    lines = [
        "Median milliseconds per frame of 1/60 s while a ball or a soft hand presses a block. The "
        "solver and the surface reconstruction have their own threads; the rest runs on Blender's "
        "thread.",
        "",
        "| particles | tool | simulation | feed | touch | write | show surface | evaluate "
        "| surface (own thread) |",
        "|---" * 9 + "|",
    ]
    for r in rows:
        times = (r.simulate, r.feed, r.touch, r.write, r.surface, r.evaluate, r.making)
        lines.append(
            f"| {r.particle_count:,} | {r.worker} | {' | '.join(f'{t:.1f}' for t in times)} |"
        )
    return [*lines, ""]


def main() -> None:
    """Measure everything, and print one line of JSON."""
    import tactile_clay

    tactile_clay.register()
    rows = [asdict(measure(spacing, hand=hand)) for spacing in SPACINGS for hand in (False, True)]
    print(json.dumps(rows), flush=True)
    tactile_clay.unregister()


if __name__ == "__main__":
    main()
