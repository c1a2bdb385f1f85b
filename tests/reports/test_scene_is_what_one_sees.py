# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands in the clay's way is what the viewport shows, and what cannot be followed is told."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.bake.bake import bake
from tactile_clay.clay_addon.core.storage.cache import Cache
from tactile_clay.clay_addon.model.clay_scene import SimulationError
from tactile_clay.clay_addon.simulate.simulation import Simulation

SPACING = 0.01


def block_collider(studio: Any, *, size: float = 0.1, at: Any = (0.0, 0.0, -0.05)) -> Any:
    """A cube that clay falls on."""
    item = studio.block(size=size, location=at)
    item.name = "Board"
    assert bpy.ops.clay.collider_add() == {"FINISHED"}
    return item


def lowest(directory: Path, number: int) -> float:
    """Height of the lowest particle at a frame."""
    return float(Cache(directory).read_frame(number).positions[:, 2].min())


def key_switch(item: Any, path: str, keys: dict[int, bool]) -> None:
    """Key a switch of an object."""
    for frame, value in keys.items():
        setattr(item, path, value)
        item.keyframe_insert(path, frame=frame)


WAYS_OFF = ["monitor", "collection", "excluded", "parent collection"]
WAYS_HIDDEN = ["H", "camera", "collection camera", "collection eye"]


def hide(item: Any, way: str) -> None:
    """Hide an object in one of Blender's ways."""
    scene = bpy.context.scene
    parent = bpy.data.collections.new("Outer")
    inner = bpy.data.collections.new("Inner")
    scene.collection.children.link(parent)
    parent.children.link(inner)
    for collection in list(item.users_collection):
        collection.objects.unlink(item)
    inner.objects.link(item)
    outer_layer = bpy.context.view_layer.layer_collection.children["Outer"]
    layer = outer_layer.children["Inner"]
    bpy.context.view_layer.update()
    if way == "monitor":
        item.hide_viewport = True
    elif way == "collection":
        inner.hide_viewport = True
    elif way == "parent collection":
        parent.hide_viewport = True
    elif way == "excluded":
        layer.exclude = True
    elif way == "H":
        item.hide_set(True)
    elif way == "camera":
        item.hide_render = True
    elif way == "collection camera":
        inner.hide_render = True
    elif way == "collection eye":
        layer.hide_viewport = True


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize("way", WAYS_OFF + WAYS_HIDDEN)
def test_what_is_off_is_not_there_and_what_is_hidden_is(studio: Any, way: str, live: bool) -> None:
    """The same in a bake and in a live session; a bake says what it left out."""
    studio.clay()
    hide(block_collider(studio), way)
    simulation = Simulation(bpy.context, live=live)
    scene = simulation.prepare(bpy.context.evaluated_depsgraph_get())
    assert len(scene.meshes) == (0 if way in WAYS_OFF else 1)
    told = [text for text in simulation.warnings() if "'Board' is off in the viewport" in text]
    assert len(told) == (1 if way in WAYS_OFF else 0)


@pytest.mark.parametrize("moves", [False, True])
def test_a_collider_keyed_off_lets_clay_fall(studio: Any, tmp_path: Path, moves: bool) -> None:
    """From the frame on at which it vanishes, and not before."""
    studio.clay(location=(0.0, 0.0, 0.021))
    board = block_collider(studio)
    key_switch(board, "hide_viewport", {1: False, 8: True})
    if moves:
        for frame, x in ((1, 0.0), (16, 0.01)):
            board.location.x = x
            board.keyframe_insert("location", index=0, frame=frame)
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    result = bake(bpy.context, start=1, end=16)
    assert lowest(result.directory, 7) > 0.3 * SPACING
    fallen = 0.5 * 9.81 * (8 / 24) ** 2
    assert lowest(result.directory, 16) < 0.5 * SPACING - 0.6 * fallen


@pytest.mark.parametrize("keyed", ["hide_viewport", "tactile_clay.collider_enabled"])
def test_a_collider_keyed_on_later_is_there_then(studio: Any, tmp_path: Path, keyed: str) -> None:
    """Its mesh, with modifiers, is that of the frame at which it appears."""
    studio.clay(location=(0.0, 0.0, 0.1))
    board = block_collider(studio)
    board.modifiers.new("Bevel", "BEVEL").width = 0.002
    if keyed == "hide_viewport":
        key_switch(board, "hide_viewport", {1: True, 3: False})
    else:
        for frame, value in ((1, False), (3, True)):
            board.tactile_clay.collider_enabled = value
            board.keyframe_insert(keyed, frame=frame)
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    result = bake(bpy.context, start=1, end=20)
    assert not any("off in the viewport" in text for text in result.warnings)
    assert 0.3 * SPACING < lowest(result.directory, 20) < 0.8 * SPACING


def test_a_hand_keyed_off_touches_nothing(studio: Any, tmp_path: Path) -> None:
    """Neither where it was when it vanished nor on its way."""
    from tactile_clay.clay_addon.hands.add_hand import add_hand

    studio.clay(location=(0.0, 0.0, 0.03))
    studio.table()
    hand = add_hand(bpy.context, side="right")
    rig = hand.find_armature()
    rig.location = (0.0, 0.0, 0.02)
    key_switch(hand, "hide_viewport", {1: True})
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    moved = bake(bpy.context, start=1, end=5)
    after = Cache(moved.directory).read_frame(5).positions
    before = Cache(moved.directory).read_frame(1).positions
    assert np.abs(after[:, :2] - before[:, :2]).max() < 0.2 * SPACING


def shelf(studio: Any, size: float, turn: tuple[float, float, float], *, kind: str) -> Any:
    """A flat mesh through the origin."""
    if kind == "disc":
        bpy.ops.mesh.primitive_circle_add(radius=size / 2, fill_type="NGON", rotation=turn)
    elif kind == "grid":
        bpy.ops.mesh.primitive_grid_add(
            x_subdivisions=4, y_subdivisions=3, size=size, rotation=turn
        )
    else:
        bpy.ops.mesh.primitive_plane_add(size=size, rotation=turn)
    item = bpy.context.object
    item.name = "Shelf"
    assert bpy.ops.clay.collider_add() == {"FINISHED"}
    return item


TURNS = [(0.0, 0.0, 0.0), (np.pi, 0.0, 0.3), (0.0, np.pi / 2, 0.0), (0.6, 0.8, 0.1)]


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("kind", ["plane", "grid", "disc"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_clay_on_both_sides_of_a_shelf_stays_there(
    studio: Any, tmp_path: Path, turn: tuple[float, float, float], kind: str, mirrored: bool
) -> None:
    """However it is turned, and pressed against it from both sides."""
    item = shelf(studio, 0.12, turn, kind=kind)
    if mirrored:
        item.scale = (1.0, -1.0, 1.0)
    bpy.context.view_layer.update()
    normal = np.array(item.matrix_world)[:3, 2]
    normal /= np.linalg.norm(normal)
    for sign, name in ((1, "Over"), (-1, "Under")):
        studio.clay(name=name, location=tuple(0.0265 * sign * normal))
        # Each is pushed against the shelf.
        studio.select()
    studio.scene.gravity = tuple(-9.81 * normal)
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    result = bake(bpy.context, start=1, end=10)
    frame = Cache(result.directory).read_frame(10).positions
    layout = Cache(result.directory).meta().layout
    over, under = layout.split(frame)
    assert (over @ normal).min() > 0.3 * SPACING
    # What is under it falls; nothing of it has come up.
    assert (under @ normal).max() < -0.3 * SPACING
    assert (under @ normal).mean() < -0.15


def test_a_table_with_all_clay_on_one_side_is_endless(studio: Any) -> None:
    """Also where the clay stands a little in it."""
    studio.clay(location=(0.0, 0.0, 0.017))
    shelf(studio, 0.01, (0.0, 0.0, 0.0), kind="plane")
    scene = Simulation(bpy.context).prepare(bpy.context.evaluated_depsgraph_get())
    assert (len(scene.planes), len(scene.meshes)) == (1, 0)


def test_a_shelf_through_clay_is_refused_by_name(studio: Any) -> None:
    """But not one that ends beside it."""
    studio.clay(name="Loaf", location=(0.0, 0.0, 0.0))
    item = shelf(studio, 0.2, (0.0, 0.0, 0.0), kind="plane")
    with pytest.raises(SimulationError, match="'Shelf' cuts through 'Loaf'"):
        Simulation(bpy.context)
    item.location.x = 0.13
    bpy.context.view_layer.update()
    scene = Simulation(bpy.context).prepare(bpy.context.evaluated_depsgraph_get())
    assert (len(scene.planes), len(scene.meshes)) == (0, 1)


@pytest.mark.parametrize("name", ["Bat", "Flügel ü.001"])
def test_a_collider_that_jumps_through_clay_is_told(studio: Any, tmp_path: Path, name: str) -> None:
    """With its name, the frame and what to do; one that jumps far from clay is not."""
    studio.clay()
    studio.table()
    for item_name, offset in ((name, 0.0), ("Far", 5.0)):
        bat = block_collider(studio, size=0.05, at=(-1.5, offset, 0.05))
        bat.name = item_name
        for frame, x in ((1, -1.5), (4, -1.5), (5, 1.5)):
            bat.location.x = x
            bat.keyframe_insert("location", index=0, frame=frame)
        for layer in bat.animation_data.action.layers:
            for key in layer.strips[0].channelbags[0].fcurves[0].keyframe_points:
                key.interpolation = "CONSTANT"
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    result = bake(bpy.context, start=1, end=6)
    told = [text for text in result.warnings if "moved too far to be followed" in text]
    assert len(told) == 1
    assert told[0].startswith(f"'{name}'")
    assert "at frame 5" in told[0]


def test_clay_squeezed_into_a_collider_is_told(studio: Any, tmp_path: Path) -> None:
    """With the name, how deep, and the frame."""
    studio.clay(location=(0.0, 0.0, 0.02))
    studio.table()
    press = block_collider(studio, size=0.2, at=(0.0, 0.0, 0.1405))
    for frame, z in ((1, 0.1405), (4, 0.1012)):
        press.location.z = z
        press.keyframe_insert("location", index=2, frame=frame)
    studio.scene.frame_set(1)
    studio.save(tmp_path)
    result = bake(bpy.context, start=1, end=6)
    told = [text for text in result.warnings if "inside" in text]
    assert told, result.warnings
    assert any("'Board'" in text or "'Table'" in text for text in told)
    assert all(" mm inside " in text and "frame" in text for text in told)
