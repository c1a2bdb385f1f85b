# SPDX-License-Identifier: GPL-3.0-or-later
"""Make Clay: closed meshes become one point cloud of clay particles."""

import math
from collections.abc import Sequence

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from mathutils.kdtree import KDTree
from numpy.typing import NDArray

from ...solver.geometry.closed_mesh import MeshError, check_closed_mesh, mesh_volume
from ..base.mesh_geometry import SWITCHED_OFF, evaluated_mesh, is_switched_off, transform, turn_for
from ..base.preferences import missing_parts
from ..base.units import from_meters, to_meters
from ..model.material_presets import SCENE, find_material, operator_items
from .look import add_look, show_colors

PARTICLE_COUNT_LIMIT = 1_000_000
"""More particles than this in one object are taken for a slip of the hand."""

PARTICLE_COUNT_LEAST = 8
"""Fewer particles than this cannot deform like clay."""

DEFAULT_COLOR = (0.72, 0.36, 0.22, 1.0)
"""Colour of a piece that has neither material nor object colour: terracotta, linear RGBA."""


class ClayError(Exception):
    """Something cannot become clay; the message says what is wrong and what to do."""


def make_clay(
    context: bpy.types.Context,
    objects: Sequence[bpy.types.Object],
    spacing: float | None = None,
    material_preset: str | None = None,
    name: str = "Clay",
) -> bpy.types.Object:
    """Make one clay object, a point cloud, out of closed meshes.

    Modifiers and the objects' transforms are applied. Where pieces overlap, the clay is there
    once. The meshes stay, hidden. Nothing is changed when an error is raised.

    Args:
        context: Where to make it.
        objects: Mesh objects.
        spacing: Distance between particles [Blender units]; the scene's where not given.
        material_preset: Name of a material preset; the scene's where not given.
        name: Name of the clay object.

    Raises:
        ClayError: The objects cannot become clay; the message names the object and the reason.
    """
    scene = context.scene
    spacing = scene.tactile_clay.spacing if spacing is None else spacing
    preset = scene.tactile_clay.material_preset if material_preset is None else material_preset
    for sentence in missing_parts():
        raise ClayError(sentence)
    try:
        find_material(preset)
    except ValueError as error:
        raise ClayError(str(error)) from error
    if not (math.isfinite(spacing) and spacing > 0):
        raise ClayError(f"The spacing is {spacing!r}; it must be above 0.")
    if not objects:
        raise ClayError("Nothing is selected. Select one or more closed meshes first.")

    pieces = _closed_meshes(objects, context.evaluated_depsgraph_get())
    _check_particle_count(pieces, spacing, scene)
    _check_place(pieces, spacing)
    points = fill_pieces(pieces, spacing, scene)
    colors = np.concatenate(
        [
            np.tile(_color_of(item), (len(part), 1))
            for item, part in zip(objects, points, strict=True)
        ]
    ).astype(np.float32)
    return _build(context, objects, np.concatenate(points), colors, spacing, preset, name)


def _closed_meshes(
    objects: Sequence[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> list[tuple[str, NDArray[np.float64], NDArray[np.int32]]]:
    """Name, world vertices and triangles of each object."""
    pieces = []
    for item in objects:
        if item.type != "MESH":
            already = item.tactile_clay.role == "CLAY"
            what = "is clay already" if already else f"is no mesh ({item.type.lower()})"
            raise ClayError(f"{item.name!r} {what}. Select closed meshes only.")
        if item.tactile_clay.role == "COLLIDER":
            raise ClayError(
                f"{item.name!r} is a collider. Leave it out of the selection, or press Remove "
                "Collider first."
            )
        if item.tactile_clay.role == "HAND":
            raise ClayError(
                f"{item.name!r} is a clay hand. Leave it out of the selection, or press Remove "
                "Clay Hand first."
            )
        if item.library is not None:
            raise ClayError(
                f"{item.name!r} is linked from another file, so it cannot be hidden in renders. "
                "Make it local first (Object > Relations > Make Local)."
            )
        if item.mode == "EDIT":
            raise ClayError(f"{item.name!r} is being edited. Leave Edit Mode first (Tab).")
        if is_switched_off(item, depsgraph):
            raise ClayError(f"{item.name!r} {SWITCHED_OFF}")
        vertices, triangles = evaluated_mesh(item, depsgraph)
        matrix = item.evaluated_get(depsgraph).matrix_world
        try:
            vertices, triangles = check_closed_mesh(
                transform(matrix, vertices), turn_for(matrix, triangles), name=repr(item.name)
            )
        except MeshError as error:
            raise ClayError(str(error)) from error
        pieces.append((item.name, vertices, triangles))
    return pieces


def _check_particle_count(
    pieces: list[tuple[str, NDArray[np.float64], NDArray[np.int32]]],
    spacing: float,
    scene: bpy.types.Scene,
) -> None:
    volumes = [mesh_volume(vertices, triangles) for _, vertices, triangles in pieces]
    total = sum(volumes)
    if total / spacing**3 > PARTICLE_COUNT_LIMIT:
        raise ClayError(
            f"That would be {_about(total / spacing**3)} particles; {PARTICLE_COUNT_LIMIT:,} are "
            f"the most. Use a spacing of at least "
            f"{_length(_rounded(total / PARTICLE_COUNT_LIMIT, up=True), scene)}, or check the "
            "size of the meshes."
        )
    for (name, _, _), volume in zip(pieces, volumes, strict=True):
        if round(volume / spacing**3) < PARTICLE_COUNT_LEAST:
            raise ClayError(
                f"{name!r} is too small for a spacing of {_length(spacing, scene)}: it would hold "
                f"{round(volume / spacing**3)} particles. Use a spacing of at most "
                f"{_length(_rounded(volume / 200, up=False), scene)}, or a larger mesh."
            )


def _check_place(
    pieces: list[tuple[str, NDArray[np.float64], NDArray[np.int32]]], spacing: float
) -> None:
    for name, vertices, _ in pieces:
        # The step of single precision at the farthest coordinate.
        if np.spacing(np.float32(np.abs(vertices).max())) > 0.01 * spacing:
            raise ClayError(
                f"{name!r} lies so far from the world's origin that single precision blurs its "
                "particles. Move it closer to the origin."
            )


def _rounded(cell_volume: float, *, up: bool) -> float:
    """Edge of a cubic cell, rounded to two digits."""
    edge = cell_volume ** (1 / 3)
    step = 10.0 ** (math.floor(math.log10(edge)) - 1)
    # Single precision makes a round edge a little longer or shorter.
    return (math.ceil(edge / step - 1e-4) if up else math.floor(edge / step + 1e-4)) * step


def _about(count: float) -> str:
    step = 10 ** max(0, math.floor(math.log10(count)) - 2)
    return f"{round(count / step) * step:,}"


def _length(value: float, scene: bpy.types.Scene) -> str:
    meters = to_meters(scene, value)
    if meters >= 1:
        return f"{meters:.3g} m"
    return f"{meters * 1e3:.3g} mm"


def fill_pieces(
    pieces: list[tuple[str, NDArray[np.float64], NDArray[np.int32]]],
    spacing: float,
    scene: bpy.types.Scene,
) -> list[NDArray[np.float32]]:
    """Particles of each piece, without those that an earlier piece has already.

    Args:
        pieces: Name, world vertices [Blender units] and triangles of each.
        spacing: Distance between particles [Blender units].
        scene: Its unit scale counts.

    Raises:
        ClayError: A piece cannot be filled.
    """
    from ...solver import fill_mesh

    filled: list[NDArray[np.float32]] = []
    for index, (name, vertices, triangles) in enumerate(pieces):
        try:
            # The solver's messages speak of meters.
            points = from_meters(
                scene,
                fill_mesh(to_meters(scene, vertices), triangles, to_meters(scene, spacing)),
            )
        except (MeshError, ValueError) as error:
            raise ClayError(f"{name!r}: {error}") from error
        for (_, other_vertices, other_triangles), other_points in zip(
            pieces[:index], filled, strict=True
        ):
            points = points[
                ~_occupied(points, other_vertices, other_triangles, other_points, spacing)
            ]
        filled.append(np.asarray(points, np.float32))
    return filled


def _occupied(
    points: NDArray[np.floating],
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    particles: NDArray[np.float32],
    spacing: float,
) -> NDArray[np.bool_]:
    """Which points lie inside a mesh, or closer than half a spacing to its particles."""
    taken = np.zeros(len(points), bool)
    low, high = vertices.min(0) - spacing, vertices.max(0) + spacing
    near = (points >= low).all(1) & (points <= high).all(1)
    if not near.any() or not len(particles):
        return taken
    tree = BVHTree.FromPolygons(vertices.tolist(), triangles.tolist())
    nearest = KDTree(len(particles))
    for index, particle in enumerate(particles.tolist()):
        nearest.insert(particle, index)
    nearest.balance()
    for index in np.flatnonzero(near).tolist():
        point = Vector(points[index].tolist())
        taken[index] = nearest.find(point)[2] < 0.5 * spacing or _inside(tree, point)
    return taken


def _inside(tree: BVHTree, point: Vector) -> bool:
    """Whether a ray out of a closed mesh crosses it an odd number of times."""
    direction = Vector((0.5773, 0.1931, 0.7934))
    crossings = 0
    while True:
        hit = tree.ray_cast(point, direction)[0]
        if hit is None:
            return crossings % 2 == 1
        crossings += 1
        point = hit + direction * 1e-5 * max(1e-3, hit.length)


def _color_of(item: bpy.types.Object) -> tuple[float, ...]:
    """Colour of a piece, linear RGBA: its material's, else the object's, else terracotta."""
    material = item.active_material
    if material is not None:
        if material.node_tree and (bpy.app.version >= (5, 0, 0) or material.use_nodes):
            for node in material.node_tree.nodes:
                if node.type == "BSDF_PRINCIPLED" and not node.inputs["Base Color"].is_linked:
                    return (*tuple(node.inputs["Base Color"].default_value)[:3], 1.0)
        return (*tuple(material.diffuse_color)[:3], 1.0)
    color = tuple(item.color)
    return DEFAULT_COLOR if color == (1.0, 1.0, 1.0, 1.0) else (*color[:3], 1.0)


def _build(
    context: bpy.types.Context,
    sources: Sequence[bpy.types.Object],
    points: NDArray[np.float32],
    colors: NDArray[np.float32],
    spacing: float,
    preset: str,
    name: str,
) -> bpy.types.Object:
    # The origin lies amid the clay, where the transform gizmo is expected.
    origin = (0.5 * (points.min(0).astype(np.float64) + points.max(0))).astype(np.float32)
    clay = make_point_cloud(context, points - origin, colors, spacing, name)
    clay.location = origin.tolist()
    properties = clay.tactile_clay
    properties.role = "CLAY"
    properties.spacing = spacing
    properties.material_preset = preset
    add_look(clay, spacing=spacing)
    for source in sources:
        source.hide_set(True)
        source.hide_render = True
        properties.sources.add().source = source
        source.select_set(False)
    clay.select_set(True)
    context.view_layer.objects.active = clay
    # Blender crashes when a script changes geometry while the interface draws it in a render.
    context.scene.render.use_lock_interface = True
    context.view_layer.update()
    return clay


def make_point_cloud(
    context: bpy.types.Context,
    points: NDArray[np.float32],
    colors: NDArray[np.float32],
    spacing: float,
    name: str,
) -> bpy.types.Object:
    """A point cloud object in the active collection, with the attributes that clay has.

    Args:
        context: Where to make it.
        points: Positions [Blender units], shape [N, 3].
        colors: Linear RGBA, shape [N, 4].
        spacing: Distance between particles [Blender units].
        name: Of the object and its points.
    """
    count = len(points)
    data = bpy.data.pointclouds.new(name)
    # The class does not have what its objects have.
    if hasattr(data, "resize"):
        data.resize(count)
        write_attributes(data, points, colors, spacing)
        item = bpy.data.objects.new(name, data)
        context.collection.objects.link(item)
        return item
    bpy.data.pointclouds.remove(data)
    # Blender 4.5 can size a point cloud in no other way than to convert a mesh.
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(count)
    write_attributes(mesh, points, colors, spacing)
    item = bpy.data.objects.new(name, mesh)
    collection = context.collection
    context.scene.collection.objects.link(item)
    item.select_set(True)
    context.view_layer.objects.active = item
    with context.temp_override(
        active_object=item, object=item, selected_objects=[item], selected_editable_objects=[item]
    ):
        bpy.ops.object.convert(target="POINTCLOUD")
    item.data.name = name
    bpy.data.meshes.remove(mesh)
    if collection != context.scene.collection:
        collection.objects.link(item)
        context.scene.collection.objects.unlink(item)
    return item


def write_attributes(
    data: bpy.types.ID, points: NDArray[np.float32], colors: NDArray[np.float32], spacing: float
) -> None:
    """Write the attributes that clay has into a point cloud, or a mesh, of N points.

    Args:
        data: What to write into.
        points: Positions [Blender units], shape [N, 3].
        colors: Linear RGBA, shape [N, 4].
        spacing: Distance between particles [Blender units].
    """
    # The name matters: Cycles shows an attribute named "color" black.
    radius = np.full(len(points), 0.5 * spacing, np.float32)
    for attribute, kind, key, values in (
        ("position", "FLOAT_VECTOR", "vector", points),
        ("radius", "FLOAT", "value", radius),
        ("Color", "FLOAT_COLOR", "color", colors),
        ("rest_position", "FLOAT_VECTOR", "vector", points),
    ):
        layer = data.attributes.get(attribute) or data.attributes.new(attribute, kind, "POINT")
        layer.data.foreach_set(key, np.ascontiguousarray(values, np.float32).ravel())
    data.update_tag()


class CLAY_OT_make(bpy.types.Operator):  # noqa: N801
    """Turn the selected closed meshes into one clay object; the meshes are kept, hidden"""

    bl_idname = "clay.make"
    bl_label = "Make Clay"
    bl_options = {"REGISTER", "UNDO"}

    spacing: bpy.props.FloatProperty(
        name="Spacing",
        description="Distance between particles; 0 takes the scene's",
        subtype="DISTANCE",
        unit="LENGTH",
        min=0.0,
        precision=4,
        options={"SKIP_SAVE"},
    )
    material_preset: bpy.props.EnumProperty(
        name="Material",
        description="What the clay is made of",
        items=operator_items,
        default=0,
        options={"SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Make the clay, or report why not."""
        window = context.window
        if window and not bpy.app.background:
            window.cursor_modal_set("WAIT")
        try:
            clay = make_clay(
                context,
                list(context.selected_objects),
                self.spacing or None,
                None if self.material_preset == SCENE else self.material_preset,
            )
        except ClayError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            if window and not bpy.app.background:
                window.cursor_modal_restore()
        show_colors()
        self.report({"INFO"}, f"{clay.name}: {len(clay.data.points):,} particles")
        return {"FINISHED"}


def register() -> None:
    """Register the operator."""
    bpy.utils.register_class(CLAY_OT_make)


def unregister() -> None:
    """Unregister the operator."""
    bpy.utils.unregister_class(CLAY_OT_make)
