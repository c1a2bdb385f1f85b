# SPDX-License-Identifier: GPL-3.0-or-later
"""Colliders: which objects may press on the clay, and what the solver receives."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from tactile_clay.clay_addon.model.clay_scene import SimulationError
from tactile_clay.clay_addon.model.collider import ColliderError, make_collider, resolve_kind
from tactile_clay.clay_addon.simulate.simulation import Simulation


def test_mesh_is_marked_and_unmarked(studio: Any) -> None:
    """Make the selected meshes colliders, undo, redo and remove."""
    block = studio.block()
    bpy.ops.ed.undo_push(message="block")
    assert bpy.ops.clay.collider_add() == {"FINISHED"}
    assert block.tactile_clay.role == "COLLIDER"
    bpy.ops.ed.undo_push(message="collider")
    bpy.ops.ed.undo()
    assert studio.scene.objects["Cube"].tactile_clay.role == "NONE"
    bpy.ops.ed.redo()
    assert studio.scene.objects["Cube"].tactile_clay.role == "COLLIDER"
    assert bpy.ops.clay.collider_remove() == {"FINISHED"}
    assert studio.scene.objects["Cube"].tactile_clay.role == "NONE"


def test_flat_mesh_is_a_plane_and_closed_mesh_is_itself(studio: Any) -> None:
    """Tell a table from a tool by its shape, even when rotated and scaled."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    bpy.ops.mesh.primitive_grid_add(size=2.0, rotation=(0.3, 0.2, 0.1), location=(5, 6, 7))
    assert resolve_kind(bpy.context.object, "AUTO", depsgraph) == "PLANE"
    block = studio.block()
    block.scale = (1.0, 1.0, 0.01)
    bpy.context.view_layer.update()
    assert resolve_kind(block, "AUTO", depsgraph) == "MESH"


def test_empty_selection_is_reported(studio: Any) -> None:
    """Say that nothing is selected, or no collider is."""
    assert "Nothing is selected" in studio.refused(bpy.ops.clay.collider_add)
    studio.block()
    assert "No collider is selected" in studio.refused(bpy.ops.clay.collider_remove)


def test_open_mesh_that_is_not_flat_is_refused(studio: Any) -> None:
    """Name the object and its holes, and mark none of the selected objects."""
    good = studio.block()
    bpy.ops.mesh.primitive_cylinder_add(end_fill_type="NOTHING")
    studio.select(good, pipe := bpy.context.object)
    assert "'Cylinder' is open: it has 2 holes" in studio.refused(bpy.ops.clay.collider_add)
    assert (good.tactile_clay.role, pipe.tactile_clay.role) == ("NONE", "NONE")


def test_object_without_faces_is_refused(studio: Any) -> None:
    """Accept meshes only."""
    bpy.ops.object.empty_add()
    assert "'Empty' is not a mesh (empty)" in studio.refused(bpy.ops.clay.collider_add)


@pytest.mark.parametrize(
    ("kind", "friction", "words"),
    [("PLANE", 0.5, "not flat"), ("BALL", 0.5, "no collider kind"), ("AUTO", -1.0, "at least 0")],
)
def test_wrong_kind_or_friction_is_refused(
    studio: Any, kind: str, friction: float, words: str
) -> None:
    """Leave the object unchanged and say what is wrong."""
    block = studio.block()
    with pytest.raises(ColliderError, match=words):
        make_collider(block, kind, friction)
    assert block.tactile_clay.role == "NONE"


def solver_colliders(simulation: Simulation) -> Any:
    """Start a simulation and return the solver's scene."""
    simulation.start(bpy.context.evaluated_depsgraph_get(), "cpu")
    assert simulation.solver is not None
    return simulation.solver.scene


@pytest.mark.parametrize("upside_down", [False, True])
def test_plane_faces_the_clay(studio: Any, upside_down: bool) -> None:
    """Keep the clay on its side of the table, whichever way the table's face points."""
    studio.clay()
    bpy.ops.mesh.primitive_plane_add(rotation=(np.pi if upside_down else 0.0, 0.0, 0.0))
    make_collider(bpy.context.object)
    (plane,) = solver_colliders(Simulation(bpy.context)).planes
    np.testing.assert_allclose(plane.normal, (0.0, 0.0, 1.0), atol=1e-6)
    np.testing.assert_allclose(plane.point[2], 0.0, atol=1e-6)


def world(mesh: Any) -> Any:
    """A collider's vertices in world coordinates, as the solver has them [m]."""
    return mesh.vertices @ mesh.pose[:3, :3].T + mesh.pose[:3, 3]


def test_solver_sees_the_collider_where_blender_shows_it(studio: Any) -> None:
    """Convert location, rotation, uneven and mirrored scale to meters at any unit scale."""
    studio.scene.unit_settings.scale_length = 0.5
    studio.clay()
    tool = make_collider(studio.block(size=1.0))
    matrix = (
        Matrix.Translation((1.0, 2.0, 3.0))
        @ Matrix.Rotation(0.8, 4, (1.0, 2.0, 0.5))
        @ Matrix.Diagonal((-0.5, 2.0, 1.0, 1.0))
    )
    tool.matrix_world = matrix
    bpy.context.view_layer.update()
    (mesh,) = solver_colliders(Simulation(bpy.context)).meshes
    expected = [0.5 * np.array(matrix @ vertex.co) for vertex in tool.data.vertices]
    np.testing.assert_allclose(world(mesh), expected, atol=1e-6)


def test_rotating_tool_keeps_its_shape_for_the_solver(studio: Any) -> None:
    """Change only the pose while a tool moves rigidly, so that the solver need not refit it."""
    studio.clay()
    tool = make_collider(studio.block(location=(0.0, 0.0, 0.5)))
    tool.scale = (1.0, 2.0, 0.7)
    for frame in (1, 20):
        tool.rotation_euler = (0.1 * frame, 0.2 * frame, 0.3 * frame)
        tool.keyframe_insert("rotation_euler", frame=frame)
    studio.scene.frame_set(1)
    simulation = Simulation(bpy.context)
    (mesh,) = solver_colliders(simulation).meshes
    shape = mesh.vertices.copy()
    for frame in range(2, 20):
        studio.scene.frame_set(frame)
        simulation.feed(bpy.context.evaluated_depsgraph_get())
        np.testing.assert_array_equal(mesh.vertices, shape)
        rotation = mesh.pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        expected = [tool.matrix_world @ vertex.co for vertex in tool.data.vertices]
        np.testing.assert_allclose(world(mesh), expected, atol=1e-6)


def test_armature_deforms_the_collider(studio: Any) -> None:
    """Pass a mesh deformed by an armature to the solver, frame by frame."""
    studio.clay()
    bpy.ops.object.armature_add()
    armature = bpy.context.object
    tool = studio.block(size=0.2, location=(0.0, 0.0, 0.5))
    tool.modifiers.new("Armature", "ARMATURE").object = armature
    tool.vertex_groups.new(name="Bone").add([4, 5, 6, 7], 1.0, "REPLACE")
    make_collider(tool)
    bone = armature.pose.bones[0]
    for frame, angle in ((1, 0.0), (10, 0.5)):
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = (angle, 0.0, 0.0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    studio.scene.frame_set(1)
    simulation = Simulation(bpy.context)
    (mesh,) = solver_colliders(simulation).meshes
    rest = world(mesh)
    first = simulation.feed(bpy.context.evaluated_depsgraph_get())
    studio.scene.frame_set(10)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert simulation.feed(depsgraph) != first
    shown = [
        tool.matrix_world @ vertex.co for vertex in tool.evaluated_get(depsgraph).data.vertices
    ]
    np.testing.assert_allclose(world(mesh), shown, atol=1e-6)
    assert np.abs(world(mesh) - rest).max() > 0.01


def test_hidden_tool_presses_and_a_switched_off_one_is_not_there(studio: Any) -> None:
    """Follow a tool hidden with H, and leave out one that Blender does not move at all."""
    studio.clay()
    tool = make_collider(studio.block(location=(0.0, 0.0, 0.5)))
    for frame in (1, 10):
        tool.location.x = float(frame)
        tool.keyframe_insert("location", frame=frame)
    tool.hide_set(True)
    studio.scene.frame_set(1)
    simulation = Simulation(bpy.context)
    (mesh,) = solver_colliders(simulation).meshes
    assert world(mesh)[:, 0].mean() == pytest.approx(1.0)
    studio.scene.frame_set(10)
    simulation.feed(bpy.context.evaluated_depsgraph_get())
    assert world(mesh)[:, 0].mean() == pytest.approx(10.0)
    tool.hide_viewport = True
    simulation = Simulation(bpy.context)
    assert not solver_colliders(simulation).meshes
    (warning,) = simulation.warnings()
    assert warning.startswith("'Cube.001' is off in the viewport")


def test_tool_switched_off_later_is_refused(studio: Any) -> None:
    """Stop when Blender no longer evaluates a tool, instead of holding it still."""
    studio.clay()
    tool = make_collider(studio.block(location=(0.0, 0.0, 0.5)))
    simulation = Simulation(bpy.context)
    tool.hide_viewport = True
    studio.scene.frame_set(2)
    with pytest.raises(SimulationError, match=r"At frame 2 'Cube\.001' is switched off"):
        simulation.feed(bpy.context.evaluated_depsgraph_get())


def test_other_scene_chosen_meanwhile_is_refused(studio: Any) -> None:
    """Refuse to read a tool from another scene, which does not animate it."""
    studio.clay()
    make_collider(studio.block(location=(0.0, 0.0, 0.5)))
    simulation = Simulation(bpy.context)
    bpy.ops.scene.new(type="NEW")
    with pytest.raises(SimulationError, match=r"active scene was changed during .* 'Scene'"):
        simulation.feed(bpy.context.evaluated_depsgraph_get())


def test_collider_that_changes_its_topology_is_refused(studio: Any) -> None:
    """Name the object, the frame and the counts."""
    studio.clay()
    tool = make_collider(studio.block(location=(0.0, 0.0, 0.5)))
    array = tool.modifiers.new("Array", "ARRAY")
    for frame, count in ((1, 1), (2, 3)):
        array.count = count
        array.keyframe_insert("count", frame=frame)
    studio.scene.frame_set(1)
    simulation = Simulation(bpy.context)
    studio.scene.frame_set(2)
    with pytest.raises(SimulationError, match="has 24 vertices at frame 2 and 8 at the"):
        simulation.feed(bpy.context.evaluated_depsgraph_get())


def test_plane_that_moves_is_refused(studio: Any) -> None:
    """Say at which frame the plane moves, and what to do instead."""
    studio.clay()
    studio.table()
    table = bpy.context.object
    for frame, height in ((1, 0.0), (3, 0.1)):
        table.location.z = height
        table.keyframe_insert("location", frame=frame)
    studio.scene.frame_set(1)
    simulation = Simulation(bpy.context)
    studio.scene.frame_set(2)
    with pytest.raises(SimulationError, match=r"'Table' moves at frame 2.*Solidify"):
        simulation.feed(bpy.context.evaluated_depsgraph_get())


def test_scene_without_clay_is_refused(studio: Any) -> None:
    """Say that there is no clay and how to get some."""
    studio.table()
    with pytest.raises(SimulationError, match=r"no clay in the scene.*Make Clay"):
        Simulation(bpy.context)


def test_scaled_clay_is_refused(studio: Any) -> None:
    """Refuse scaled clay, but allow clay to be moved and rotated."""
    clay = studio.clay()
    clay.location.x += 1.0
    clay.rotation_euler = (0.3, 0.2, 0.1)
    bpy.context.view_layer.update()
    positions = np.concatenate(Simulation(bpy.context).rest)
    np.testing.assert_array_equal(positions, studio.points(clay))
    clay.scale = (2.0, 2.0, 2.0)
    bpy.context.view_layer.update()
    with pytest.raises(SimulationError, match="'Clay' is scaled"):
        Simulation(bpy.context)


def test_linked_duplicate_of_clay_is_refused(studio: Any) -> None:
    """Refuse two objects that would show the same points."""
    clay = studio.clay()
    twin = bpy.data.objects.new("Twin", clay.data)
    twin.tactile_clay.role = "CLAY"
    twin.tactile_clay.spacing = 0.01
    studio.scene.collection.objects.link(twin)
    with pytest.raises(SimulationError, match=r"'Twin' is a linked duplicate of 'Clay'.*Single"):
        Simulation(bpy.context)
    twin.data = clay.data.copy()
    assert len(Simulation(bpy.context).rest) == 2


def test_clay_that_blender_does_not_evaluate_is_refused(studio: Any) -> None:
    """Accept clay hidden with H, but not clay that is switched off."""
    clay = studio.clay()
    clay.hide_set(True)
    assert len(Simulation(bpy.context).rest) == 1
    clay.hide_viewport = True
    with pytest.raises(SimulationError, match="'Clay' is switched off in the viewport"):
        Simulation(bpy.context)


def test_clay_with_non_finite_transform_is_refused(studio: Any) -> None:
    """Name the object, and do not claim that it is scaled."""
    studio.clay().location.x = float("nan")
    bpy.context.view_layer.update()
    with pytest.raises(SimulationError, match="transform of 'Clay' is not finite"):
        Simulation(bpy.context)


def test_plane_that_becomes_non_finite_is_refused(studio: Any) -> None:
    """Stop at the frame where a plane's location is not a number."""
    studio.clay()
    table = studio.table()
    simulation = Simulation(bpy.context)
    table.location.z = float("nan")
    bpy.context.view_layer.update()
    with pytest.raises(SimulationError, match="'Table' moves at frame 1"):
        simulation.feed(bpy.context.evaluated_depsgraph_get())


def test_name_of_a_collider_does_not_matter(studio: Any) -> None:
    """Keep a bake valid when a tool is renamed."""
    studio.clay()
    tool = make_collider(studio.block(location=(0.0, 0.0, 0.5)))
    before = Simulation(bpy.context).digests()
    tool.name = "Thumb"
    assert Simulation(bpy.context).digests() == before
    tool.tactile_clay.collider_friction = 0.1
    assert Simulation(bpy.context).digests() != before


def test_linked_collider_is_refused(studio: Any, tmp_path: Path) -> None:
    """Refuse an object whose role would be lost when the file is saved."""
    item = studio.linked(tmp_path)
    assert "Make it local" in studio.refused(bpy.ops.clay.collider_add)
    with pytest.raises(ColliderError, match="'Cube' is linked from another file"):
        make_collider(item)
    assert item.tactile_clay.role == "NONE"


def test_clay_of_different_spacing_is_refused(studio: Any) -> None:
    """Name each clay object with its spacing."""
    studio.clay("Fine")
    studio.clay("Coarse").tactile_clay.spacing = 0.02
    with pytest.raises(SimulationError, match="'Coarse' 20 mm, 'Fine' 10 mm"):
        Simulation(bpy.context)


def test_gravity_is_the_scenes(studio: Any) -> None:
    """Use the scene's gravity, and none if the scene disables it."""
    studio.clay()
    studio.scene.gravity = (0.0, 1.0, -2.0)
    np.testing.assert_allclose(Simulation(bpy.context).gravity, (0.0, 1.0, -2.0))
    studio.scene.use_gravity = False
    np.testing.assert_allclose(Simulation(bpy.context).gravity, 0.0)


def test_keyframes_lift_a_tool_off_the_clay_and_set_it_on(studio: Any) -> None:
    """Pass to solver and digests at each frame whether the tool touches the clay."""
    studio.clay()
    tool = make_collider(studio.block(location=(0.0, 0.0, 0.5)))
    values = tool.tactile_clay
    for frame, touches in ((1, True), (3, False), (5, True)):
        values.collider_enabled = touches
        tool.keyframe_insert("tactile_clay.collider_enabled", frame=frame)
    studio.scene.frame_set(1)
    simulation = Simulation(bpy.context)
    (mesh,) = solver_colliders(simulation).meshes
    seen, states = [], []
    for frame in range(1, 7):
        studio.scene.frame_set(frame)
        states.append(simulation.feed(bpy.context.evaluated_depsgraph_get()))
        seen.append(mesh.enabled)
    assert seen == [True, True, False, False, True, True]
    assert states[0] == states[1] == states[4]
    assert states[2] == states[3] != states[0]
    tool.animation_data_clear()
    values.collider_enabled = False
    studio.scene.frame_set(6)
    simulation.feed(bpy.context.evaluated_depsgraph_get())
    assert not mesh.enabled


def test_plane_that_does_not_touch_the_clay_is_refused(studio: Any) -> None:
    """An infinite plane cannot be disabled; the message says what to do instead."""
    studio.clay()
    studio.table().tactile_clay.collider_enabled = False
    simulation = Simulation(bpy.context)
    with pytest.raises(SimulationError, match=r"'Table' does not touch the clay at frame 1"):
        simulation.feed(bpy.context.evaluated_depsgraph_get())
