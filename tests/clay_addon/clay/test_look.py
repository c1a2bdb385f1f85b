# SPDX-License-Identifier: GPL-3.0-or-later
"""The look of the clay: a smooth surface from Blender's own nodes, in the clay's own colors."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from tactile_clay.clay_addon.clay import look
from tactile_clay.clay_addon.clay.look_material import MATERIAL_NAME, clay_material
from tactile_clay.clay_addon.core.surface.exact import check_closed_manifold, reconstruct
from tactile_clay.clay_addon.model.point_cloud import make_point_cloud

RED, BLUE = (0.7, 0.02, 0.02, 1.0), (0.02, 0.05, 0.7, 1.0)


@pytest.fixture(autouse=True)
def empty_file() -> None:
    """Start each test with an empty file; nothing here needs the add-on registered."""
    bpy.ops.wm.read_factory_settings(use_empty=True)


def block(*counts: int) -> np.ndarray:
    """Particles of a slightly disordered block, one unit apart, centered."""
    axes = [np.arange(count) - (count - 1) / 2 for count in counts]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return points + np.random.default_rng(0).normal(0, 0.04, points.shape)


def clay(points: np.ndarray, spacing: float = 0.005) -> Any:
    """Clay that is red on the left and blue on the right."""
    colors = np.where(points[:, :1] < 0, RED, BLUE).astype(np.float32)
    return make_point_cloud(
        bpy.context, (points * spacing).astype(np.float32), colors, spacing, "Clay"
    )


def shown(item: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Vertices, triangles and colors of the evaluated mesh; None if points are shown."""
    # The geometry set owns the mesh, so it must stay alive.
    geometry = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    mesh = geometry.mesh
    if mesh is None or len(mesh.vertices) == 0:
        assert len(geometry.pointcloud.points) == len(item.data.points)
        return None
    vertices = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", vertices.ravel())
    mesh.calc_loop_triangles()
    faces = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("vertices", faces.ravel())
    colors = np.empty((len(mesh.vertices), 4), np.float32)
    mesh.attributes["Color"].data.foreach_get("color", colors.ravel())
    assert MATERIAL_NAME in [slot.name for slot in mesh.materials if slot]
    return vertices.astype(np.float64), faces.astype(np.int64), colors


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume of a closed mesh."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("spacing", [0.0005, 0.005, 5.0])
def test_surface_is_closed_smooth_and_in_place_at_any_spacing(spacing: float) -> None:
    """Show a block as one closed mesh with flat faces where the clay ends."""
    points = block(10, 10, 10)
    item = clay(points, spacing)
    look.add_look(item)
    mesh = shown(item)
    assert mesh is not None
    vertices, faces, _ = mesh[0] / spacing, mesh[1], mesh[2]
    check_closed_manifold(faces, len(vertices))
    assert volume(vertices, faces) == pytest.approx(1000, rel=0.08)
    middle = (np.abs(vertices[:, :2]) < 2.5).all(axis=1) & (vertices[:, 2] > 3)
    assert vertices[middle, 2].mean() == pytest.approx(5, abs=0.2)
    assert vertices[middle, 2].std() < 0.05


def test_colors_are_those_of_the_particles_and_mix_only_where_they_meet() -> None:
    """Keep colors pure beyond 1.2 spacings from the border between two of them."""
    item = clay(block(8, 6, 6))
    look.add_look(item)
    mesh = shown(item)
    assert mesh is not None
    x, colors = mesh[0][:, 0] / 0.005, mesh[2]
    far = np.abs(x) > 1.2
    np.testing.assert_allclose(colors[far], np.where(x[far, None] < 0, RED, BLUE), atol=0.01)
    middle = colors[np.abs(x) < 0.2, 0]
    assert ((middle > 0.1) & (middle < 0.6)).any()


def test_crumbs_and_sheets_do_not_vanish() -> None:
    """Roughly keep the volume of a single particle and of a sheet of one layer."""
    item = clay(np.array([[-10.0, 0, 0], [0, 0, 0], [10, 0, 0]]))
    look.add_look(item)
    mesh = shown(item)
    assert mesh is not None
    assert volume(mesh[0] / 0.005, mesh[1]) == pytest.approx(3, rel=0.35)
    sheet = clay(block(16, 16, 1))
    look.add_look(sheet)
    mesh = shown(sheet)
    assert mesh is not None
    assert volume(mesh[0] / 0.005, mesh[1]) == pytest.approx(256, rel=0.25)


def test_switch_and_limit_choose_between_points_and_surface() -> None:
    """Show points in the viewport if the surface is off or there are too many particles."""
    item = clay(block(6, 6, 6))
    modifier = look.add_look(item)
    assert shown(item) is not None
    look.set_input(modifier, "Viewport Limit", 100)
    assert shown(item) is None
    look.set_input(modifier, "Viewport Limit", 216)
    assert shown(item) is not None
    look.set_input(modifier, "Surface", False)
    assert shown(item) is None


def set_stage(folder: Path) -> None:
    """Set up the scene to render the clay from the front: linear, transparent background."""
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0, -1, 0), (np.pi / 2, 0, 0)
    camera.data.type, camera.data.ortho_scale = "ORTHO", 0.08
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    scene.collection.objects.link(sun)
    sun.rotation_euler = (np.pi / 2, 0, 0)
    sun.data.energy = 3.0
    scene.camera = camera
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 4
    scene.cycles.use_denoising = False
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = 32, 16
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.filepath = str(folder / "clay.exr")


def picture(folder: Path) -> np.ndarray:
    """The pixels of the rendered picture, shape [16, 32, 4]."""
    image = bpy.data.images.load(str(folder / "clay.exr"))
    pixels = np.empty(32 * 16 * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(16, 32, 4)


def render(folder: Path) -> np.ndarray:
    """Render the clay from the front."""
    set_stage(folder)
    bpy.ops.render.render(write_still=True)
    return picture(folder)


RENDER = """
import os, sys
import bpy
bpy.ops.wm.open_mainfile(filepath=sys.argv[-1])
assert not [name for name in sys.modules if name.startswith("tactile_clay")]
bpy.ops.render.render(write_still=True)
sys.stdout.flush()
os._exit(0)
"""


def test_saved_file_renders_its_surface_without_the_addon(tmp_path: Path) -> None:
    """Render the same picture in a new process that never loads the add-on."""
    item = clay(block(10, 6, 6))
    look.add_look(item)
    here = render(tmp_path)
    (tmp_path / "clay.exr").unlink()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "clay.blend"))
    words = [sys.executable, "-c", RENDER, str(tmp_path / "clay.blend")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    there = picture(tmp_path)
    assert (there[6:10, 7:25, 3] > 0.99).all()
    np.testing.assert_allclose(there, here, atol=0.02)


@pytest.mark.parametrize("kind", ["surface", "points", "beyond the limit", "exact"])
def test_cycles_shows_the_colors(kind: str, tmp_path: Path) -> None:
    """Render surface and points in the clay's colors, and the surface even beyond the limit."""
    points = block(10, 6, 6)
    item = clay(points)
    modifier = look.add_look(item)
    if kind == "points":
        look.set_input(modifier, "Surface", False)
    elif kind == "beyond the limit":
        look.set_input(modifier, "Viewport Limit", 10)
    elif kind == "exact":
        colors = np.where(points[:, :1] < 0, RED, BLUE)
        surface = reconstruct(points * 0.005, 0.005, colors=colors)
        bpy.data.objects.remove(item)
        bpy.context.collection.objects.link(look.surface_object(surface, "Exact"))
    pixels = render(tmp_path)
    left, right = pixels[6:10, 9:14].mean(axis=(0, 1)), pixels[6:10, 18:23].mean(axis=(0, 1))
    # Balls leave gaps between them.
    assert min(left[3], right[3]) > (0.8 if kind == "points" else 0.99)
    assert left[0] > 0.2
    assert left[0] > 4 * left[2]
    assert right[2] > 0.2
    assert right[2] > 4 * right[0]
    if kind == "beyond the limit":
        assert (pixels[6:10, 7:25, 3] > 0.99).all()


def test_a_second_call_adds_nothing_and_follows_the_spacing() -> None:
    """Keep one modifier, one material and one node group when the look is added twice."""
    item = clay(block(3, 3, 3))
    first = look.add_look(item)
    look.set_input(first, "Surface", False)
    second = look.add_look(item, spacing=0.01)
    assert len(item.modifiers) == len(item.data.materials) == 1
    assert second.name == first.name == look.MODIFIER_NAME
    assert look.get_input(second, "Spacing") == pytest.approx(0.01)
    assert look.get_input(second, "Surface") is False
    look.add_look(clay(block(3, 3, 3)))
    assert len(bpy.data.node_groups) == 1
    assert [item.name for item in bpy.data.materials] == [MATERIAL_NAME]


def test_material_reads_the_color_attribute_and_is_shared() -> None:
    """Use one clay material whose base color is the attribute `Color`."""
    material = clay_material()
    assert clay_material() == material
    shader = next(n for n in material.node_tree.nodes if n.bl_idname == "ShaderNodeBsdfPrincipled")
    assert shader.inputs["Base Color"].links[0].from_node.attribute_name == "Color"


def test_foreign_material_of_the_same_name_is_left_alone() -> None:
    """Neither use nor change a user's own material called Clay."""
    own = bpy.data.materials.new(MATERIAL_NAME)
    assert clay_material() != own
    assert clay_material() == clay_material()


def test_objects_that_are_not_clay_are_refused() -> None:
    """Refuse a mesh, a point cloud without radius and a spacing of zero, by name."""
    mesh = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    with pytest.raises(ValueError, match="'Cube' is a mesh"):
        look.add_look(mesh)
    item = clay(block(2, 2, 2))
    with pytest.raises(ValueError, match="above 0"):
        look.add_look(item, spacing=0.0)
    item.data.attributes.remove(item.data.attributes["radius"])
    with pytest.raises(ValueError, match="no particle radius"):
        look.add_look(item)
    with pytest.raises(KeyError, match="no input 'Color'"):
        look.set_input(look.add_look(clay(block(2, 2, 2))), "Color", 1)


def test_surface_object_is_the_reconstruction() -> None:
    """Give the mesh object the surface's vertices and colors, and smooth shading."""
    points = block(5, 5, 5)
    surface = reconstruct(points, 1.0, colors=np.where(points[:, :1] < 0, RED, BLUE))
    item = look.surface_object(surface, "Exact")
    mesh = item.data
    assert not mesh.validate(verbose=True)
    assert len(mesh.polygons) == len(surface.faces)
    assert mesh.polygons[0].use_smooth
    vertices = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", vertices.ravel())
    np.testing.assert_allclose(vertices, surface.vertices, atol=1e-5)
    colors = np.empty((len(mesh.vertices), 4), np.float32)
    mesh.attributes["Color"].data.foreach_get("color", colors.ravel())
    np.testing.assert_array_equal(colors, surface.colors)
    assert mesh.materials[0] == clay_material()
    assert mesh.attributes["clay_spacing"].data[0].value == pytest.approx(1.0, rel=0.2)


def test_solid_views_show_the_clays_colors() -> None:
    """Color solid views by attribute, except those set to another color type."""
    bpy.ops.wm.read_factory_settings()
    spaces = [
        space
        for screen in bpy.data.screens
        for area in screen.areas
        for space in area.spaces
        if space.type == "VIEW_3D"
    ]
    assert len(spaces) > 1
    for space in spaces:
        space.shading.color_type = "MATERIAL"
    spaces[0].shading.color_type = "RANDOM"
    look.show_colors()
    assert spaces[0].shading.color_type == "RANDOM"
    assert {space.shading.color_type for space in spaces[1:]} == {"VERTEX"}


def test_grain_moves_with_the_clay() -> None:
    """Keep the grain on clay that moves, and give clay without rest positions a grain too."""
    item = clay(block(6, 6, 6))
    look.add_look(item)

    def grain() -> np.ndarray:
        geometry = item.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
        values = np.empty((len(geometry.mesh.vertices), 3), np.float32)
        geometry.mesh.attributes["clay_texture"].data.foreach_get("vector", values.ravel())
        return values

    before = grain()
    assert np.ptp(before, axis=0).min() > 4
    positions = np.empty((216, 3), np.float32)
    layer = item.data.attributes["position"].data
    layer.foreach_get("vector", positions.ravel())
    # By whole voxels, so that the mesh stays the same.
    layer.foreach_set("vector", (positions + np.array([0.05, 0, 0], np.float32)).ravel())
    item.data.update_tag()
    moved = grain()
    np.testing.assert_allclose(moved.min(axis=0), before.min(axis=0), atol=0.1)
    np.testing.assert_allclose(moved.max(axis=0), before.max(axis=0), atol=0.1)
    item.data.attributes.remove(item.data.attributes["rest_position"])
    item.data.update_tag()
    np.testing.assert_allclose(
        grain().mean(axis=0), before.mean(axis=0) + np.array([10, 0, 0]), atol=0.2
    )
