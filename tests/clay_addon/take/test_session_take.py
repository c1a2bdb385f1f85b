# SPDX-License-Identifier: GPL-3.0-or-later
"""A recorded live session, from the first stroke to the film."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.core.tools.edits import Edit
from tactile_clay.clay_addon.model.cache_folder import resolve_directory
from tactile_clay.clay_addon.model.clay_scene import clay_objects
from tactile_clay.clay_addon.sculpt.live.current import current
from tactile_clay.clay_addon.sculpt.live.session import SculptSession
from tactile_clay.clay_addon.take.film import make_film
from tactile_clay.clay_addon.take.store import take_edits

from ..sculpt.live.test_session import Clock, Finger, Sculpting, top_of


def test_recorded_session_plays_and_bakes_again(studio: Any, tmp_path: Path) -> None:
    """After presses, Undo and edits, timeline and film show the live clay."""
    scene = studio.scene
    scene.render.fps = 60
    clay = studio.clay(location=(0.0, 0.0, 0.02))
    studio.table()
    studio.save(tmp_path)
    scene.tactile_clay.record_take = True
    finger, clock = Finger(height=0.06), Clock()
    current.session = running = SculptSession(bpy.context, tools=finger, clock=clock)
    sculpting = Sculpting(running, finger, clock)
    sculpting.run(0.1)
    high = top_of(studio, clay)
    sculpting.press(0.03)
    first, mark = studio.points(clay), clay.data["clay_state"]
    sculpting.press(0.02)
    assert top_of(studio, clay) < first[:, 2].max() - 0.01
    inverse = np.linalg.inv(np.array(clay.matrix_world))
    local = first @ inverse[:3, :3].T + inverse[:3, 3]
    clay.data.attributes["position"].data.foreach_set("vector", local.astype(np.float32).ravel())
    clay.data["clay_state"] = mark
    running.undone()
    sculpting.run(0.1)
    finger.edits = [Edit("paint", (0.02, 0.0, 0.02), 0.015, color=(0.0, 0.0, 1.0, 1.0))]
    sculpting.run(0.05)
    finger.edits = [Edit("add", (-0.01, -0.01, 0.045), 0.012)]
    sculpting.run(0.2)
    current.stop(bpy.context)
    live = studio.points(clay)
    assert len(live) > 64
    last = scene.frame_end
    assert scene.frame_current == last
    # The take does not contain the undone press: two presses of half a second would not fit.
    assert (last - 1) / 60 < 1.4
    assert [edit.kind for edit in take_edits(scene)] == ["paint", "add"]
    assert [*range(1, last + 1)] == Cache(resolve_directory(scene)).frames()
    scene.frame_set(1)
    assert top_of(studio, clay) >= high - 0.001
    lowest = min(_dent(studio, scene, clay, frame) for frame in range(1, last + 1, 3))
    assert 0.027 < lowest < 0.036
    film = make_film(bpy.context, spacing=0.01)
    bpy.context.window.scene = film
    result = bake(bpy.context)
    assert result.warnings == ()
    baked = Cache(result.directory).read_frame(result.end).positions
    there = np.unique(baked, axis=0)
    assert len(there) == len(live)
    error = np.sort(there, axis=0) - np.sort(live, axis=0)
    assert np.sqrt((error**2).mean()) < 0.05 * 0.01
    (fine,) = clay_objects(film)
    blue = np.zeros((len(fine.data.points), 4), np.float32)
    fine.data.attributes["Color"].data.foreach_get("color", blue.ravel())
    assert (blue[:, 2] > 0.8).any()


def _dent(studio: Any, scene: Any, clay: Any, frame: int) -> float:
    scene.frame_set(frame)
    points = studio.points(clay)
    return float(points[np.linalg.norm(points[:, :2], axis=1) < 0.008, 2].max())
