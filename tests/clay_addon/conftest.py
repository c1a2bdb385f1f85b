# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures: a fresh Blender with the add-on, a mouse over clay, and tracked hands."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

import tactile_clay
from tactile_clay.clay_addon.core.tracking.protocol.receiver import Receiver
from tactile_clay.tests.clay_addon.core.brush.fake_mouse import Mouse
from tactile_clay.tests.clay_addon.core.tracking.hands import Clock, leap_recordings


class Studio:
    """An empty Blender scene, with shortcuts for filling it."""

    @property
    def scene(self) -> Any:
        """The scene."""
        return bpy.context.scene

    def block(
        self, size: float = 0.04, location: tuple[float, float, float] = (0.0, 0.0, 0.03)
    ) -> Any:
        """Add a cube and select it alone."""
        bpy.ops.mesh.primitive_cube_add(size=size, location=location)
        return bpy.context.object

    def table(self) -> Any:
        """Add a plane at height 0 as a collider."""
        bpy.ops.mesh.primitive_plane_add(size=1.0)
        bpy.context.object.name = "Table"
        assert bpy.ops.clay.collider_add() == {"FINISHED"}
        return bpy.context.object

    def clay(self, name: str = "Clay", **block: Any) -> Any:
        """Add a block of clay with 64 particles at a spacing of one centimeter."""
        from tactile_clay.clay_addon.clay.make_clay import make_clay

        return make_clay(bpy.context, [self.block(**block)], spacing=0.01, name=name)

    def camera(self) -> Any:
        """Add a light and a camera that sees block and table, and set a small resolution."""
        bpy.ops.object.light_add(type="SUN", rotation=(0.5, 0.3, 0.0))
        bpy.ops.object.camera_add(location=(0.2, -0.2, 0.15), rotation=(1.1, 0.0, 0.785))
        render = self.scene.render
        self.scene.camera = bpy.context.object
        render.engine = "CYCLES"
        self.scene.cycles.samples = 1
        render.resolution_x, render.resolution_y = 32, 24
        return self.scene.camera

    def falling_block(self, folder: Path, *, end: int = 6) -> Any:
        """Make and save a scene in which a block of clay falls on a table; returns the clay."""
        clay = self.clay()
        self.table()
        self.scene.frame_end = end
        self.save(folder)
        return clay

    def save(self, folder: Path, name: str = "scene.blend") -> Path:
        """Save the file in a folder and return its path."""
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / name))
        return folder / name

    def select(self, *items: Any) -> None:
        """Select objects, and no others."""
        for item in bpy.context.view_layer.objects:
            item.select_set(item in items)
        bpy.context.view_layer.objects.active = items[0] if items else None

    def points(self, clay: Any, attribute: str = "position") -> NDArray[np.float32]:
        """World positions of a clay object's points [Blender units], shape [N, 3]."""
        values = np.empty((len(clay.data.points), 3), np.float32)
        clay.data.attributes[attribute].data.foreach_get("vector", values.ravel())
        matrix = np.array(clay.matrix_world, np.float64)
        return (values @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)

    def linked(self, folder: Path) -> Any:
        """Link a cube from a library written to a folder, and select it alone."""
        block = self.block()
        path = folder / "library.blend"
        bpy.data.libraries.write(str(path), {block})
        bpy.data.objects.remove(block)
        with bpy.data.libraries.load(str(path), link=True) as (_, into):
            into.objects = ["Cube"]
        (item,) = into.objects
        self.scene.collection.objects.link(item)
        bpy.context.view_layer.update()
        self.select(item)
        return item

    def refused(self, operator: Any, **options: Any) -> str:
        """Check that an operator fails without changing any object; returns its error."""
        before = {item.name: (item.type, item.hide_get()) for item in self.scene.objects}
        with pytest.raises(RuntimeError) as caught:
            operator(**options)
        after = {item.name: (item.type, item.hide_get()) for item in self.scene.objects}
        assert after == before
        return str(caught.value)


@pytest.fixture
def studio() -> Iterator[Studio]:
    """An empty scene with the add-on registered."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    tactile_clay.register()
    yield Studio()
    tactile_clay.unregister()
    bpy.ops.wm.read_factory_settings(use_empty=True)


@pytest.fixture
def clock() -> Clock:
    """A clock that moves only when a test advances it."""
    return Clock()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    """A receiver on a port chosen by the system."""
    with Receiver(0) as receiver:
        yield receiver


# No deadline: timings mean nothing on a shared machine.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")

_RECORDINGS: list[Path | None] = [*leap_recordings()] or [None]


@pytest.fixture(params=_RECORDINGS, ids=lambda path: path.name if path else "none")
def leap_recording(request: pytest.FixtureRequest) -> Any:
    """Each of the real recordings."""
    if request.param is None:
        pytest.skip("the Leap recordings are not here")
    path: Path = request.param
    return path


@pytest.fixture
def mouse() -> Mouse:
    """A mouse with a brush over a ten-centimeter block of clay."""
    return Mouse()
