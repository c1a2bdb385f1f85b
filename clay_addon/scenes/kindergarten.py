# SPDX-License-Identifier: GPL-3.0-or-later
"""The kindergarten scene: blocks of modelling clay on a table, and small hands that work them.

After section V of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021: 2,114 particles of colored clay. A palm flattens a block, two fingers pinch the head off
a caterpillar, two hands push two blocks together, and a finger presses a dent. Suzanne watches.

All of it are ordinary objects with modifiers, armatures and keyframes, to be changed by hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import radians

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...solver.geometry.closed_mesh import mesh_volume
from ..base.mesh_geometry import evaluated_mesh, transform
from ..clay.make_clay import make_clay
from ..model.collider import make_collider
from .kindergarten_hands import add_hands
from .parts import Vec3, mesh_object, plain_material
from .stage import (
    add_area_light,
    add_camera,
    add_room_light,
    look_through_camera,
    set_clock_and_units,
    set_render,
)

PARTICLE_COUNT = 2114
"""As many particles as the paper's kindergarten scene has."""
SPACING = 0.005
"""Distance between particles [m]."""
FRAME_COUNT = 120

_SUZANNE_TILT = Matrix.Rotation(radians(-24.0), 4, "X")
"""Makes her look up."""


@dataclass(frozen=True)
class Kindergarten:
    """What the scene is made of."""

    clay: bpy.types.Object
    """The clay, a point cloud."""
    pieces: tuple[bpy.types.Object, ...]
    """The meshes it was made from, hidden."""
    hands: tuple[bpy.types.Object, ...]
    """The right and the left clay hand, keyed."""


@dataclass(frozen=True)
class _Piece:
    """A piece of clay before it is worked."""

    name: str
    particle_count: int
    color: Vec3
    """Linear RGB."""
    place: tuple[float, float]
    """Where on the table its middle stands [m]."""
    turn: float
    """About the vertical [degrees]."""
    shape: Callable[[str], bpy.types.Object]


def build(context: bpy.types.Context) -> Kindergarten:
    """Build the scene into an empty Blender scene, ready to bake and to render.

    Args:
        context: Its scene is filled.
    """
    scene = context.scene
    scene.name = "Kindergarten"
    set_clock_and_units(scene, FRAME_COUNT)
    _add_table(context)
    pieces = {piece.name: _add_piece(context, piece) for piece in _PIECES}
    clay = make_clay(context, tuple(pieces.values()), SPACING, "plasticine", "Modelling clay")
    hands = add_hands(context)
    _paint_eyes(clay, pieces["Orange Suzanne"])
    _add_lights(context)
    add_camera(context, (0.020, -0.415, 0.315), (0.020, 0.000, 0.010))
    set_render(scene, 1080, 720)
    look_through_camera(context)
    return Kindergarten(clay, tuple(pieces.values()), hands)


# Clay ------------------------------------------------------------------------------------------


def _add_piece(context: bpy.types.Context, piece: _Piece) -> bpy.types.Object:
    """Stand a piece on the table, scaled to hold exactly its number of particles."""
    item = piece.shape(piece.name)
    item.data.materials.append(plain_material(piece.name, piece.color, 0.6))
    context.view_layer.update()
    vertices, triangles = evaluated_mesh(item, context.evaluated_depsgraph_get())
    factor = (piece.particle_count * SPACING**3 / mesh_volume(vertices, triangles)) ** (1 / 3)
    item.scale = (factor,) * 3
    item.rotation_euler = (0.0, 0.0, radians(piece.turn))
    item.location = (*piece.place, -factor * float(vertices[:, 2].min()))
    context.view_layer.update()
    return item


def _active(name: str) -> bpy.types.Object:
    """Name the mesh that an operator has just added."""
    item = bpy.context.object
    item.name = item.data.name = name
    return item


def _close(item: bpy.types.Object, voxel: float) -> bpy.types.Object:
    """Make one closed surface of whatever parts a mesh has."""
    remesh = item.modifiers.new("Close", "REMESH")
    remesh.mode = "VOXEL"
    remesh.voxel_size = voxel
    return item


def _block(name: str, cells: int) -> bpy.types.Object:
    """A cube of so many particles a side whose eight corners, one particle each, are cut off."""
    bpy.ops.mesh.primitive_cube_add(size=1.0)
    item = _active(name)
    cut = item.modifiers.new("Corners", "BEVEL")
    cut.affect, cut.segments, cut.limit_method = "VERTICES", 1, "NONE"
    cut.width = 6.0 ** (1.0 / 3.0) / cells
    return item


def _suzanne(name: str) -> bpy.types.Object:
    bpy.ops.mesh.primitive_monkey_add(size=1.0)
    item = _active(name)
    item.data.transform(_SUZANNE_TILT)
    # Ears of a particle's thickness would break off: make her a little chubby.
    plump = item.modifiers.new("Chubby", "DISPLACE")
    plump.strength, plump.mid_level = 0.03, 0.0
    _flatten_base(item, -0.25)
    return _close(item, 0.02)


def _caterpillar(name: str) -> bpy.types.Object:
    """A loaf of a body, a neck and a ball of a head, along Y with the head at -Y."""
    parts = (
        ((0.0, 0.024, 0.0150), (0.0175, 0.0250, 0.0160)),
        ((0.0, -0.010, 0.0080), (0.0056, 0.0160, 0.0062)),
        ((0.0, -0.031, 0.0135), (0.0150, 0.0145, 0.0150)),
    )
    items = []
    for center, radii in parts:
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=1.0)
        part = bpy.context.object
        part.data.transform(Matrix.LocRotScale(center, None, radii))
        items.append(part)
    with bpy.context.temp_override(
        active_object=items[0], object=items[0], selected_editable_objects=items
    ):
        bpy.ops.object.join()
    item = items[0]
    item.name = item.data.name = name
    _flatten_base(item, 0.0015)
    return _close(item, 0.0015)


def _flatten_base(item: bpy.types.Object, height: float) -> None:
    """Press a mesh flat below a height, so that it stands."""
    for vertex in item.data.vertices:
        vertex.co.z = max(vertex.co.z, height)


def _paint_eyes(clay: bpy.types.Object, suzanne: bpy.types.Object) -> None:
    """Give Suzanne's eyes, too small for pieces of their own, a color by particle."""
    positions = np.empty((len(clay.data.points), 3), np.float32)
    clay.data.attributes["position"].data.foreach_get("vector", positions.ravel())
    places = transform(clay.matrix_world, positions)
    layer = clay.data.attributes["Color"]
    colors = np.empty((len(positions), 4), np.float32)
    layer.data.foreach_get("color", colors.ravel())
    for side in (-1.0, 1.0):
        eye = suzanne.matrix_world @ _SUZANNE_TILT @ Vector((side * 0.18, -0.40, 0.13))
        near = np.linalg.norm(places - np.array(eye), axis=1) < 1.6 * SPACING
        colors[near] = (0.86, 0.84, 0.78, 1.0)
        pupil = np.array(eye) - (side * 0.002, 0.4 * SPACING, 0.0)
        colors[np.argmin(np.linalg.norm(places - pupil, axis=1))] = (0.015, 0.012, 0.012, 1.0)
    layer.data.foreach_set("color", colors.ravel())


_PIECES = (
    _Piece("Red block", 208, (0.62, 0.025, 0.020), (-0.106, 0.014), 4.0, partial(_block, cells=6)),
    _Piece(
        "Yellow block", 208, (0.87, 0.50, 0.020), (-0.0215, 0.045), 0.0, partial(_block, cells=6)
    ),
    _Piece("Blue block", 208, (0.020, 0.13, 0.56), (0.0215, 0.045), 0.0, partial(_block, cells=6)),
    _Piece("Green caterpillar", 392, (0.10, 0.42, 0.035), (0.074, -0.050), 90.0, _caterpillar),
    _Piece("Orange Suzanne", 890, (0.80, 0.17, 0.012), (-0.040, -0.080), 0.0, _suzanne),
    _Piece(
        "Violet block", 208, (0.20, 0.045, 0.36), (0.115, 0.038), 12.0, partial(_block, cells=6)
    ),
)


# Table, light and camera -----------------------------------------------------------------------


def _add_table(context: bpy.types.Context) -> None:
    """Add a wooden table top: to the clay an infinite plane."""
    corners = np.array([(x, y, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    top = mesh_object("Table", 0.6 * corners, [(0, 1, 2, 3)])
    material = plain_material("Wood", (0.60, 0.40, 0.22), 0.38)
    tree = material.node_tree
    place = tree.nodes.new("ShaderNodeTexCoord")
    stretch = tree.nodes.new("ShaderNodeMapping")
    stretch.inputs["Scale"].default_value = (3.0, 26.0, 1.0)
    grain = tree.nodes.new("ShaderNodeTexNoise")
    grain.inputs["Scale"].default_value = 2.5
    grain.inputs["Detail"].default_value = 6.0
    grain.inputs["Distortion"].default_value = 0.6
    tint = tree.nodes.new("ShaderNodeValToRGB")
    tint.color_ramp.elements[0].position, tint.color_ramp.elements[1].position = 0.30, 0.72
    tint.color_ramp.elements[0].color = (0.50, 0.30, 0.145, 1.0)
    tint.color_ramp.elements[1].color = (0.68, 0.47, 0.27, 1.0)
    shader = tree.nodes["Principled BSDF"]
    tree.links.new(place.outputs["Object"], stretch.inputs["Vector"])
    tree.links.new(stretch.outputs["Vector"], grain.inputs["Vector"])
    tree.links.new(grain.outputs[0], tint.inputs["Fac"])
    tree.links.new(tint.outputs["Color"], shader.inputs["Base Color"])
    top.data.materials.append(material)
    make_collider(top, "PLANE", 0.8)


def _add_lights(context: bpy.types.Context) -> None:
    for name, place, energy, size, color in (
        ("Window", (-0.55, -0.05, 0.62), 7.5, 0.35, (1.0, 0.84, 0.66)),
        ("Lamp", (0.45, 0.55, 0.60), 4.0, 0.30, (1.0, 0.90, 0.78)),
    ):
        add_area_light(context, name, place, energy, size, color)
    add_room_light(context, 0.22)
