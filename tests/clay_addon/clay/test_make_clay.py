# SPDX-License-Identifier: GPL-3.0-or-later
"""Make Clay: meshes become particles, and what cannot is refused."""

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from mathutils import Matrix

from tactile_clay.clay_addon.clay import make_clay as module
from tactile_clay.clay_addon.clay.make_clay import make_clay
from tactile_clay.clay_addon.clay.meshes import ClayError


def test_block_becomes_a_point_cloud_of_its_volume(studio: Any) -> None:
    """Fill a block with volume / spacing³ particles with radius, color and rest position."""
    studio.block(size=0.04, location=(0.1, 0.2, 0.3))
    assert bpy.ops.clay.make(spacing=0.005) == {"FINISHED"}
    clay = bpy.context.object
    assert (clay.type, clay.tactile_clay.role, clay.name) == ("POINTCLOUD", "CLAY", "Clay")
    positions = studio.points(clay)
    assert len(positions) == 512
    assert np.abs(positions - (0.1, 0.2, 0.3)).max() < 0.02
    np.testing.assert_array_equal(positions, studio.points(clay, "rest_position"))
    radius = np.empty(512, np.float32)
    clay.data.attributes["radius"].data.foreach_get("value", radius)
    np.testing.assert_allclose(radius, 0.0025)
    color = clay.data.attributes["Color"]
    assert (color.data_type, color.domain) == ("FLOAT_COLOR", "POINT")


def test_sources_are_hidden_and_remembered(studio: Any) -> None:
    """Keep the meshes, hidden in viewport and render, and select the clay instead."""
    block = studio.block()
    clay = make_clay(bpy.context, [block], spacing=0.01)
    assert (block.hide_get(), block.hide_render, block.select_get()) == (True, True, False)
    assert [entry.source for entry in clay.tactile_clay.sources] == [block]
    assert bpy.context.object == clay
    assert clay.select_get()
    assert studio.scene.render.use_lock_interface


def test_scale_modifiers_and_rotation_are_honored(studio: Any) -> None:
    """Fill the shape that the viewport shows."""
    block = studio.block(size=0.02, location=(0.0, 0.0, 0.0))
    block.scale = (3.0, 1.0, 0.5)
    block.rotation_euler = (0.0, 0.0, np.pi / 2)
    block.modifiers.new("Array", "ARRAY").count = 2
    clay = make_clay(bpy.context, [block], spacing=0.0025)
    positions = studio.points(clay)
    assert len(positions) * 0.0025**3 == pytest.approx(2 * 0.06 * 0.02 * 0.01, rel=0.01)
    np.testing.assert_allclose(np.ptp(positions, axis=0), (0.02, 0.12, 0.01), atol=0.003)


@pytest.mark.parametrize("scale", [(-1.0, 1.0, 1.0), (-1.0, -2.0, -1.0)])
def test_mirrored_object_is_filled(studio: Any, scale: tuple[float, float, float]) -> None:
    """Fill an object with negative scale like any other."""
    block = studio.block(size=0.04)
    block.scale = scale
    clay = make_clay(bpy.context, [block], spacing=0.01)
    assert len(clay.data.points) == round(64 * abs(np.prod(scale)))


def test_parented_object_is_filled_where_it_is_seen(studio: Any) -> None:
    """Use the world transform, including a parent's shear."""
    parent = bpy.data.objects.new("Parent", None)
    studio.scene.collection.objects.link(parent)
    parent.matrix_world = Matrix.Translation((1.0, 0.0, 0.0)) @ Matrix.Diagonal((2, 1, 1, 1))
    block = studio.block(size=0.04, location=(0.0, 0.0, 0.0))
    block.rotation_euler = (0.0, 0.0, 0.7)
    block.parent = parent
    bpy.context.view_layer.update()
    clay = make_clay(bpy.context, [block], spacing=0.01)
    positions = studio.points(clay)
    assert len(positions) == 128
    np.testing.assert_allclose(positions.mean(0), (1.0, 0.0, 0.0), atol=0.005)


def test_several_pieces_make_one_clay_object_with_their_colors(studio: Any) -> None:
    """Take each piece's color from its shader, its viewport color, or the object."""
    shaded, viewport, plain, bare = (
        studio.block(size=0.02, location=(0.03 * index, 0.0, 0.0)) for index in range(4)
    )
    material = bpy.data.materials.new("Shaded")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (1, 0, 0, 1)
    shaded.active_material = material
    material = bpy.data.materials.new("Viewport")
    material.diffuse_color = (0, 1, 0, 1)
    if material.node_tree:
        material.node_tree.nodes.clear()
    viewport.active_material = material
    plain.color = (0, 0, 1, 1)
    clay = make_clay(bpy.context, [shaded, viewport, plain, bare], spacing=0.01)
    colors = np.empty((32, 4), np.float32)
    clay.data.attributes["Color"].data.foreach_get("color", colors.ravel())
    np.testing.assert_allclose(colors[:8], [(1, 0, 0, 1)] * 8)
    np.testing.assert_allclose(colors[8:16], [(0, 1, 0, 1)] * 8)
    np.testing.assert_allclose(colors[16:24], [(0, 0, 1, 1)] * 8)
    np.testing.assert_allclose(colors[24:], [module.DEFAULT_COLOR] * 8)


def test_overlapping_pieces_are_one_body(studio: Any) -> None:
    """Fill the overlap of two pieces only once, so that nothing explodes."""
    first = studio.block(size=0.04, location=(0.0, 0.0, 0.0))
    second = studio.block(size=0.04, location=(0.023, 0.0, 0.0))
    clay = make_clay(bpy.context, [first, second], spacing=0.005)
    positions = studio.points(clay)
    assert len(positions) * 0.005**3 == pytest.approx(0.063 * 0.04 * 0.04, rel=0.05)
    offsets = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    assert offsets[offsets > 0].min() >= 0.5 * 0.005


def test_touching_pieces_keep_all_their_clay(studio: Any) -> None:
    """Completely fill two blocks that share a face."""
    first = studio.block(size=0.04, location=(0.0, 0.0, 0.0))
    second = studio.block(size=0.04, location=(0.04, 0.0, 0.0))
    clay = make_clay(bpy.context, [first, second], spacing=0.005)
    assert len(clay.data.points) == 1024


def test_default_spacing_is_half_a_centimeter_at_any_unit_scale(studio: Any) -> None:
    """Use 5 mm in a scene modeled in millimeters too."""
    assert studio.scene.tactile_clay.spacing == pytest.approx(0.005)
    studio.scene.unit_settings.scale_length = 0.001
    assert studio.scene.tactile_clay.spacing == pytest.approx(5.0)
    clay = make_clay(bpy.context, [studio.block(size=40.0)])
    assert len(clay.data.points) == 512
    studio.scene.tactile_clay.spacing = 4.0
    assert studio.scene.tactile_clay.spacing == pytest.approx(4.0)


def test_preset_fills_values_and_changing_one_makes_it_custom(studio: Any) -> None:
    """Copy a preset's values to the properties, and switch to Custom when one is changed."""
    clay = make_clay(bpy.context, [studio.block()], spacing=0.01, material_preset="wet_clay")
    properties = clay.tactile_clay
    assert (properties.density, properties.yield_stress) == (1800.0, 1000.0)
    properties.material_preset = "stiff_clay"
    assert properties.yield_stress == 25000.0
    properties.yield_stress = 123.0
    assert properties.material_preset == "CUSTOM"
    assert properties.density == 1900.0


def test_undo_and_redo_restore_the_clay(studio: Any) -> None:
    """Undo Make Clay, and get the same particles back with Redo."""
    studio.block(size=0.04)
    bpy.ops.ed.undo_push(message="block")
    bpy.ops.clay.make(spacing=0.01)
    positions = studio.points(bpy.context.object)
    bpy.ops.ed.undo_push(message="clay")
    bpy.ops.ed.undo()
    assert [item.type for item in studio.scene.objects] == ["MESH"]
    assert not studio.scene.objects[0].hide_get()
    bpy.ops.ed.redo()
    clay = studio.scene.objects["Clay"]
    np.testing.assert_array_equal(studio.points(clay), positions)
    np.testing.assert_array_equal(studio.points(clay, "rest_position"), positions)


def test_empty_selection_is_refused(studio: Any) -> None:
    """Say that nothing is selected."""
    studio.block()
    studio.select()
    assert "Nothing is selected" in studio.refused(bpy.ops.clay.make)


def test_object_that_is_not_a_mesh_is_refused(studio: Any) -> None:
    """Name the object and its type."""
    bpy.ops.object.light_add(type="POINT")
    assert "'Point' is not a mesh (light)" in studio.refused(bpy.ops.clay.make)


def test_clay_is_not_made_of_clay(studio: Any) -> None:
    """Say that the selected object is already clay."""
    studio.select(studio.clay())
    assert "'Clay' is already clay" in studio.refused(bpy.ops.clay.make)


def test_open_mesh_is_refused_with_its_holes_counted(studio: Any) -> None:
    """Name the open object among closed ones, and the number of its holes."""
    good = studio.block(location=(1.0, 0.0, 0.0))
    bpy.ops.mesh.primitive_cylinder_add(
        vertices=12, radius=0.02, depth=0.04, end_fill_type="NOTHING"
    )
    pipe = bpy.context.object
    studio.select(good, pipe)
    message = studio.refused(bpy.ops.clay.make)
    assert "'Cylinder' is open: it has 2 holes" in message
    assert "Fill Holes" in message


def test_flat_mesh_is_refused(studio: Any) -> None:
    """Say that a mesh without volume cannot be filled."""
    block = studio.block()
    block.data.transform(Matrix.Diagonal((1.0, 1.0, 0.0, 1.0)))
    assert "'Cube'" in (message := studio.refused(bpy.ops.clay.make))
    assert "no volume" in message


def test_vertices_that_are_not_numbers_are_refused(studio: Any) -> None:
    """Say how many vertices are not finite."""
    block = studio.block()
    block.data.vertices[3].co = (float("nan"), 0.0, 0.0)
    assert "'Cube' has 1 vertices that are not finite" in studio.refused(bpy.ops.clay.make)


def test_mesh_too_small_for_the_spacing_is_refused(studio: Any) -> None:
    """Suggest a spacing, and accept that spacing."""
    studio.block(size=0.008)
    message = studio.refused(bpy.ops.clay.make, spacing=0.01)
    assert "'Cube' is too small for a spacing of 10 mm" in message
    assert "at most 1.3 mm" in message
    assert bpy.ops.clay.make(spacing=0.0013) == {"FINISHED"}


def test_too_many_particles_are_refused(studio: Any) -> None:
    """Say how many there would be, and suggest a spacing."""
    studio.block(size=2.0)
    message = studio.refused(bpy.ops.clay.make, spacing=0.005)
    assert "64,000,000 particles" in message
    assert "at least 20 mm" in message


def test_object_in_edit_mode_is_refused(studio: Any) -> None:
    """Ask the user to leave Edit Mode, where the object's mesh is out of date."""
    studio.block()
    bpy.ops.object.mode_set(mode="EDIT")
    assert "Edit Mode" in studio.refused(bpy.ops.clay.make)


def test_unknown_preset_is_refused(studio: Any) -> None:
    """List the available presets."""
    with pytest.raises(ClayError, match=r"no material preset 'butter'\. Available: plasticine"):
        make_clay(bpy.context, [studio.block()], spacing=0.01, material_preset="butter")


def test_missing_warp_is_reported(studio: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Say what is missing and what to do if Warp is not installed."""
    monkeypatch.setattr(module, "missing_parts", lambda: ["NVIDIA Warp is missing: install it."])
    studio.block()
    assert "Warp is missing" in studio.refused(bpy.ops.clay.make)


def test_collider_is_refused(studio: Any) -> None:
    """Refuse to make clay of an object that presses on clay."""
    studio.block()
    bpy.ops.clay.collider_add()
    assert "'Cube' is a collider" in studio.refused(bpy.ops.clay.make)


def test_linked_object_is_refused(studio: Any, tmp_path: Path) -> None:
    """Refuse a mesh that would be visible in renders again once the file is reopened."""
    item = studio.linked(tmp_path)
    assert "'Cube' is linked from another file" in studio.refused(bpy.ops.clay.make)
    assert not item.hide_render


def test_mesh_far_from_the_origin_is_refused(studio: Any) -> None:
    """Refuse to make clay where single precision cannot resolve its particles."""
    studio.scene.tactile_clay.spacing = 0.01
    studio.block(location=(1000.0, 0.0, 0.0))
    assert bpy.ops.clay.make() == {"FINISHED"}
    studio.block(location=(0.0, 10_000.0, 0.0))
    assert "too far from the world origin" in studio.refused(bpy.ops.clay.make)
