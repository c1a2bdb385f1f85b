# SPDX-License-Identifier: GPL-3.0-or-later
"""The live surface replaces the clay in the viewport, and leaves nothing behind."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.base.mesh_geometry import is_switched_off
from tactile_clay.clay_addon.clay import look
from tactile_clay.clay_addon.clay.look_material import clay_material
from tactile_clay.clay_addon.core.surface.exact import check_closed_manifold
from tactile_clay.clay_addon.model.clay_scene import clay_colors
from tactile_clay.clay_addon.sculpt.live.surface import LiveSurface, sweep


class Live:
    """A block of clay with a live surface."""

    def __init__(self, studio: Any) -> None:
        self.studio = studio
        self.clay = studio.clay()
        self.surface = LiveSurface(bpy.context, [self.clay])

    def tick(self, moved: float = 0.0) -> bool:
        """Offer the clay, moved along x, wait for its surface and show it."""
        positions = self.studio.points(self.clay) + np.array([moved, 0, 0], np.float32)
        self.surface.offer([(positions, clay_colors(self.clay))])
        assert self.surface._worker is not None
        assert self.surface._worker.wait()
        return self.surface.show()

    def stand_ins(self) -> list[Any]:
        """The stand-ins in the scene."""
        return [item for item in bpy.context.scene.objects if item.name.startswith("Live clay")]

    def shows_itself(self) -> bool:
        """Whether the clay is displayed as before, without a stand-in."""
        clay = bpy.data.objects["Clay"]
        return (
            not self.stand_ins()
            and not clay.hide_get()
            and clay.modifiers[look.MODIFIER_NAME].show_viewport
            and not any(key.startswith("tactile_clay_") for key in clay.keys())  # noqa: SIM118
            and not any(mesh.name.startswith("Live clay") for mesh in bpy.data.meshes)
        )


@pytest.fixture
def live(studio: Any) -> Iterator[Live]:
    """A live surface, closed afterwards."""
    made = Live(studio)
    yield made
    made.surface.close()


def test_mesh_replaces_the_clay(live: Live) -> None:
    """Show a closed mesh in the clay's place and colors, and hide the clay itself."""
    assert not live.surface.show()
    assert live.tick()
    (item,) = live.stand_ins()
    mesh = item.data
    assert not mesh.validate(verbose=True)
    assert item.hide_render
    assert item.hide_select
    assert live.clay.hide_get()
    assert not live.clay.hide_render
    assert list(mesh.materials) == [clay_material()]
    assert mesh.attributes.active_color_name == "Color"
    assert all(polygon.use_smooth for polygon in mesh.polygons)
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.attributes[".corner_vert"].data.foreach_get("value", corners)
    check_closed_manifold(
        corners.reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int64),
        len(mesh.vertices),
    )
    vertices = np.array([vertex.co for vertex in mesh.vertices])
    np.testing.assert_allclose(vertices.min(0), (-0.02, -0.02, 0.01), atol=0.002)
    np.testing.assert_allclose(vertices.max(0), (0.02, 0.02, 0.05), atol=0.002)
    np.testing.assert_allclose(mesh.attributes["Color"].data[0].color, clay_colors(live.clay)[0])


def test_hidden_clay_is_still_evaluated_without_its_surface(live: Live) -> None:
    """Keep evaluating the clay for solver and renders, without its own surface."""
    live.tick()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert not is_switched_off(live.clay, depsgraph)
    geometry = live.clay.evaluated_get(depsgraph).evaluated_geometry()
    assert geometry.mesh is None
    assert len(geometry.pointcloud.points) == 64


def test_mesh_is_written_only_when_clay_moves(live: Live) -> None:
    """Rewrite the mesh of the same object when the clay has moved, and only then."""
    live.tick()
    (item,) = live.stand_ins()
    bpy.context.scene.name = live.clay.name = "Renamed"
    assert live.tick(0.1)
    assert live.stand_ins() == [item]
    assert np.array([vertex.co for vertex in item.data.vertices])[:, 0].min() > 0.05
    assert not live.tick(0.1)
    assert len(item.data.materials) == 1


def test_close_restores_the_clay(live: Live) -> None:
    """Remove the mesh, show the clay's own surface, and restore the selection."""
    live.studio.select(live.clay)
    live.tick()
    assert not live.shows_itself()
    live.surface.close()
    live.surface.close()
    assert live.shows_itself()
    assert live.clay.select_get()
    assert bpy.context.view_layer.objects.active == live.clay
    assert not live.surface.show()


def test_clay_that_was_hidden_stays_hidden(studio: Any) -> None:
    """Show only what was visible before."""
    clay = studio.clay()
    clay.hide_set(True)
    clay.modifiers[look.MODIFIER_NAME].show_viewport = False
    made = Live.__new__(Live)
    made.studio, made.clay, made.surface = studio, clay, LiveSurface(bpy.context, [clay])
    made.tick()
    made.surface.close()
    assert clay.hide_get()
    assert not clay.modifiers[look.MODIFIER_NAME].show_viewport


def test_slow_surface_shows_points_until_the_clay_rests(
    live: Live, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If surfaces cannot keep pace, show points while the clay moves, then its surface."""
    monkeypatch.setattr("tactile_clay.clay_addon.sculpt.live.surface.MAX_SECONDS", 0.0)
    assert live.tick()
    assert not live.surface.keeps_pace
    assert not live.clay.hide_get()
    assert not live.stand_ins()
    assert not live.tick(0.1)
    assert live.tick(0.1)
    assert live.clay.hide_get()
    assert not live.stand_ins()[0].hide_get()
    assert live.tick(0.2)
    assert live.stand_ins()[0].hide_get()
    assert not live.clay.hide_get()
    live.surface.close()
    assert live.shows_itself()


def test_failed_surface_is_reported(live: Live) -> None:
    """Show points and say what is wrong, until a surface can be made again."""
    live.tick()
    live.surface.offer([(np.zeros((3, 2)), np.zeros((3, 4)))])
    assert live.surface._worker is not None
    live.surface._worker.wait()
    assert live.surface.show()
    assert "(N, 3)" in live.surface.problem
    assert not live.clay.hide_get()
    assert live.tick(0.1)
    assert live.surface.problem == ""
    assert live.clay.hide_get()


def test_files_hold_no_stand_in(live: Live, tmp_path: Path) -> None:
    """Save the file without the stand-in, and keep showing the surface."""
    live.tick()
    path = live.studio.save(tmp_path)
    assert live.stand_ins()
    assert live.clay.hide_get()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert live.shows_itself()
    assert not live.surface.show()


def test_stand_in_in_a_file_is_removed(live: Live, tmp_path: Path) -> None:
    """Clean up a file that was saved without the handlers, as an autosave is."""
    from tactile_clay.clay_addon.sculpt.live import surface

    live.tick()
    surface.unregister()
    live.surface = LiveSurface(bpy.context, [live.clay])
    live.tick()
    path = live.studio.save(tmp_path)
    live.surface.close()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert not live.shows_itself()
    surface.register()
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert live.shows_itself()


def test_undo_restores_the_stand_in_only_during_the_session(live: Live) -> None:
    """Show the surface again after Undo, but restore no stand-in after the session."""
    bpy.ops.ed.undo_push(message="before")
    live.tick()
    bpy.ops.ed.undo_push(message="stroke")
    live.tick(0.1)
    bpy.ops.ed.undo_push(message="stroke")
    bpy.ops.ed.undo()
    (item,) = live.stand_ins()
    assert np.array([vertex.co for vertex in item.data.vertices])[:, 0].min() > 0.05
    assert bpy.data.objects["Clay"].hide_get()
    live.surface.close()
    bpy.ops.ed.undo_push(message="end")
    bpy.ops.ed.undo()
    live.clay = bpy.data.objects["Clay"]
    assert live.shows_itself()


def test_no_clay_is_refused(studio: Any) -> None:
    """Say that there is no clay, and accept a scene without stand-ins to remove."""
    with pytest.raises(ValueError, match="no clay"):
        LiveSurface(bpy.context, [])
    sweep(bpy.context.scene)
