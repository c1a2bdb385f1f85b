# SPDX-License-Identifier: GPL-3.0-or-later
"""The kindergarten scene: blocks of modelling clay on a table, and small hands that work them.

After section V of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021: 2,114 particles of coloured clay. One hand presses a block flat, two push two blocks
together, and two more pull the head off a caterpillar. Suzanne watches.

All of it are ordinary objects with modifiers, shape keys and keyframes, to be changed by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import radians

import bpy
import numpy as np
from mathutils import Matrix, Vector
from numpy.typing import NDArray

from ..solver.closed_mesh import mesh_volume
from ..solver.hand_mesh import hand_mesh_in_poses
from ..solver.hand_shape import POSES, HandPose, hand_shape
from .collider import make_collider
from .make_clay import make_clay
from .mesh_geometry import evaluated_mesh, transform

PARTICLE_COUNT = 2114
"""As many particles as the paper's kindergarten scene has."""
SPACING = 0.005
"""Distance between particles [m]."""
FRAME_COUNT = 120
FRAMES_PER_SECOND = 60
HAND_LENGTH = 0.135
"""From wrist to fingertip of a child of six [m]."""

Vec3 = tuple[float, float, float]

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
    """The hands, keyed colliders."""


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


@dataclass(frozen=True)
class _Hand:
    """A hand that moves along a path."""

    name: str
    side: str
    poses: tuple[HandPose, ...]
    """One pose, or two that `grip` mixes."""
    forward: Vec3
    """Where straight fingers point."""
    back: Vec3
    """Where the back of the hand looks."""
    anchor: tuple[str, ...]
    """The joints whose middle goes along the path."""
    path: tuple[tuple[int, Vec3], ...]
    """Frame, and where the anchor is [m]."""
    grip: tuple[tuple[int, float], ...] = ()
    """Frame, and share of the second pose."""
    sleeve: Vec3 = (0.55, 0.52, 0.46)
    """Linear RGB."""


def build(context: bpy.types.Context) -> Kindergarten:
    """Build the scene into an empty Blender scene, ready to bake and to render.

    Args:
        context: Its scene is filled.
    """
    scene = context.scene
    scene.name = "Kindergarten"
    scene.frame_start, scene.frame_end = 1, FRAME_COUNT
    scene.frame_set(1)
    scene.render.fps, scene.render.fps_base = FRAMES_PER_SECOND, 1.0
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.length_unit = "CENTIMETERS"
    _add_table(context)
    pieces = tuple(_add_piece(context, piece) for piece in _PIECES)
    hands = tuple(_add_hand(context, hand) for hand in _HANDS)
    clay = make_clay(context, pieces, SPACING, "plasticine", "Modelling clay")
    _paint_eyes(clay, bpy.data.objects["Orange Suzanne"])
    _add_lights(context)
    _add_camera(context)
    _set_render(scene)
    _look_through_camera()
    return Kindergarten(clay, pieces, hands)


# Clay ------------------------------------------------------------------------------------------


def _add_piece(context: bpy.types.Context, piece: _Piece) -> bpy.types.Object:
    """Stand a piece on the table, scaled to hold exactly its number of particles."""
    item = piece.shape(piece.name)
    item.data.materials.append(_material(piece.name, piece.color, 0.6))
    context.view_layer.update()
    vertices, triangles = evaluated_mesh(item, context.evaluated_depsgraph_get())
    factor = (piece.particle_count * SPACING**3 / mesh_volume(vertices, triangles)) ** (1 / 3)
    item.scale = (factor,) * 3
    item.rotation_euler = (0.0, 0.0, radians(piece.turn))
    item.location = (*piece.place, -factor * float(vertices[:, 2].min()))
    context.view_layer.update()
    return item


def _mesh_object(name: str, vertices: NDArray, faces: Sequence | NDArray) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices).tolist(), [], [list(face) for face in faces])
    mesh.update()
    item = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(item)
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
    _flatten_base(item, -0.31)
    return _close(item, 0.02)


def _caterpillar(name: str) -> bpy.types.Object:
    """A loaf of a body, a neck and a ball of a head, along Y with the head at -Y."""
    parts = (
        ((0.0, 0.022, 0.0150), (0.0175, 0.0250, 0.0160)),
        ((0.0, -0.008, 0.0095), (0.0085, 0.0140, 0.0085)),
        ((0.0, -0.027, 0.0135), (0.0150, 0.0145, 0.0150)),
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
    """Give Suzanne's eyes, too small for pieces of their own, a colour by particle."""
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
    _Piece("Red block", 335, (0.62, 0.025, 0.020), (-0.096, -0.030), 4.0, partial(_block, cells=7)),
    _Piece(
        "Yellow block", 208, (0.87, 0.50, 0.020), (-0.0975, 0.055), 0.0, partial(_block, cells=6)
    ),
    _Piece("Blue block", 208, (0.020, 0.13, 0.56), (-0.0545, 0.055), 0.0, partial(_block, cells=6)),
    _Piece("Green caterpillar", 392, (0.10, 0.42, 0.035), (0.077, 0.034), 90.0, _caterpillar),
    _Piece("Orange Suzanne", 854, (0.80, 0.17, 0.012), (0.004, -0.062), 0.0, _suzanne),
    _Piece(
        "Violet block", 117, (0.20, 0.045, 0.36), (0.098, -0.056), 28.0, partial(_block, cells=5)
    ),
)


# Hands -----------------------------------------------------------------------------------------

_PRESSING = replace(
    POSES["flat"],
    index=(-2.0, 0.0, 2.0, 2.0),
    middle=(0.0, 0.0, 2.0, 2.0),
    ring=(2.0, 0.0, 2.0, 2.0),
    little=(6.0, 0.0, 2.0, 2.0),
    thumb=(-28.0, -10.0, 0.0, 4.0, 2.0),
)
_SPREAD = replace(
    _PRESSING,
    index=(-7.0, -8.0, 4.0, 2.0),
    middle=(0.0, -8.0, 4.0, 2.0),
    ring=(7.0, -8.0, 4.0, 2.0),
    little=(14.0, -8.0, 4.0, 2.0),
)
_HOLDING = replace(_PRESSING, thumb=(-8.0, 24.0, 0.0, 4.0, 2.0))
_PUSHING = replace(_PRESSING, little=(4.0, 0.0, 2.0, 2.0), thumb=(-24.0, -14.0, 0.0, 4.0, 2.0))
_PINCHED = replace(
    POSES["pinch"],
    middle=(0.0, -8.0, 62.0, 34.0),
    ring=(4.0, -10.0, 62.0, 34.0),
    little=(9.0, -10.0, 58.0, 34.0),
)
_OPEN = replace(_PINCHED, index=(-6.0, 25.0, 52.0, 27.0), thumb=(14.0, 13.0, 50.0, 0.0, 0.0))

_KNUCKLES = ("index_proximal", "middle_proximal", "ring_proximal", "middle_intermediate")
_FINGERTIPS = ("thumb_tip", "index_tip")

_HANDS = (
    _Hand(
        "Pressing hand",
        "right",
        (_SPREAD,),
        forward=(1.0, -0.06, -0.30),
        back=(0.0, 0.0, 1.0),
        anchor=("index_intermediate", "middle_intermediate", "ring_intermediate"),
        sleeve=(0.42, 0.10, 0.08),
        path=(
            (1, (-0.150, -0.010, 0.100)),
            (16, (-0.102, -0.028, 0.047)),
            (60, (-0.096, -0.030, 0.0185)),
            (68, (-0.096, -0.030, 0.0185)),
            (92, (-0.116, -0.020, 0.065)),
            (120, (-0.330, 0.030, 0.150)),
        ),
    ),
    _Hand(
        "Pushing hand right",
        "right",
        (_PUSHING,),
        forward=(0.10, -1.0, -0.16),
        back=(-1.0, 0.0, 0.0),
        anchor=_KNUCKLES,
        sleeve=(0.10, 0.22, 0.30),
        path=(
            (1, (-0.156, 0.095, 0.052)),
            (18, (-0.124, 0.057, 0.0385)),
            (60, (-0.109, 0.057, 0.0385)),
            (68, (-0.109, 0.057, 0.0385)),
            (92, (-0.146, 0.075, 0.050)),
            (120, (-0.166, 0.330, 0.160)),
        ),
    ),
    _Hand(
        "Pushing hand left",
        "left",
        (_PUSHING,),
        forward=(-0.10, -1.0, -0.16),
        back=(1.0, 0.0, 0.0),
        anchor=_KNUCKLES,
        sleeve=(0.10, 0.22, 0.30),
        path=(
            (1, (-0.012, 0.095, 0.052)),
            (18, (-0.028, 0.057, 0.0385)),
            (60, (-0.043, 0.057, 0.0385)),
            (68, (-0.043, 0.057, 0.0385)),
            (92, (-0.030, 0.085, 0.060)),
            (120, (-0.045, 0.330, 0.160)),
        ),
    ),
    _Hand(
        "Holding hand",
        "left",
        (_HOLDING,),
        forward=(0.06, -1.0, -0.30),
        back=(0.0, 0.0, 1.0),
        anchor=("middle_intermediate", "ring_intermediate"),
        sleeve=(0.36, 0.13, 0.24),
        path=(
            (1, (0.058, 0.070, 0.080)),
            (22, (0.041, 0.036, 0.0340)),
            (34, (0.041, 0.036, 0.0290)),
            (94, (0.041, 0.036, 0.0290)),
            (104, (0.044, 0.044, 0.050)),
            (120, (0.085, 0.330, 0.170)),
        ),
    ),
    _Hand(
        "Pinching hand",
        "left",
        (_OPEN, _PINCHED),
        forward=(-0.30, -0.92, -0.26),
        back=(0.0, 0.0, 1.0),
        anchor=_FINGERTIPS,
        sleeve=(0.55, 0.36, 0.10),
        path=(
            (1, (0.118, 0.060, 0.070)),
            (26, (0.087, 0.034, 0.014)),
            (42, (0.086, 0.034, 0.013)),
            (88, (0.135, 0.030, 0.014)),
            (94, (0.135, 0.030, 0.014)),
            (104, (0.140, 0.040, 0.055)),
            (120, (0.200, 0.330, 0.170)),
        ),
        grip=((26, 0.0), (42, 1.0), (88, 1.0), (96, 0.0)),
    ),
)


def _add_hand(context: bpy.types.Context, hand: _Hand) -> bpy.types.Object:
    """Add a hand as a keyed collider."""
    forms, faces = hand_mesh_in_poses(hand.poses, hand.side, length=HAND_LENGTH)
    item = _mesh_object(hand.name, forms[0], faces)
    item.data.shade_smooth()
    item.data.materials.append(_hand_material())
    if len(forms) > 1:
        item.shape_key_add(name="Open")
        closed = item.shape_key_add(name="Closed")
        closed.data.foreach_set("co", np.asarray(forms[1], np.float32).ravel())
        for frame, value in hand.grip:
            closed.value = value
            closed.keyframe_insert("value", frame=frame)
    back = Vector(hand.back)
    forward = Vector(hand.forward).normalized()
    side = forward.cross(back).normalized()
    turn = Matrix((side, forward, side.cross(forward))).transposed()
    item.rotation_euler = turn.to_euler()
    joints = [
        hand_shape(hand.side, length=HAND_LENGTH, pose=hand.poses[-1]).joints[name]
        for name in hand.anchor
    ]
    anchor = turn @ Vector(np.mean(joints, axis=0).tolist())
    for frame, place in hand.path:
        item.location = Vector(place) - anchor
        item.keyframe_insert("location", frame=frame)
    _add_sleeve(item, hand)
    context.scene.frame_set(context.scene.frame_current)
    return make_collider(item, "MESH", 0.5)


_CUFF = (
    (-0.034, 0.000), (-0.016, 0.001), (-0.012, 0.0035), (-0.015, 0.0065),
    (-0.034, 0.0075), (-0.039, 0.0055), (-0.044, 0.0060), (-0.120, 0.010), (-0.450, 0.018),
)  # fmt: skip
"""Profile of a sleeve: way along the arm, and distance to the wrist's skin [m]."""


def _add_sleeve(item: bpy.types.Object, hand: _Hand) -> None:
    """Dress the wrist; the sleeve goes with the hand and does not touch the clay."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    rings = [
        np.stack(
            [(0.028 + gap) * np.cos(angle), np.full(24, way), (0.0185 + gap) * np.sin(angle)],
            axis=1,
        )
        for way, gap in _CUFF
    ]
    vertices = np.concatenate(rings) * (HAND_LENGTH / 0.19)
    faces = [
        (24 * ring + n, 24 * ring + (n + 1) % 24, 24 * ring + 24 + (n + 1) % 24, 24 * ring + 24 + n)
        for ring in range(len(rings) - 1)
        for n in range(24)
    ]
    sleeve = _mesh_object(f"{hand.name}, sleeve", vertices, faces)
    sleeve.data.shade_smooth()
    sleeve.modifiers.new("Soft", "SUBSURF").levels = 1
    name = f"Cloth {hand.sleeve}"
    sleeve.data.materials.append(bpy.data.materials.get(name) or _material(name, hand.sleeve, 0.9))
    sleeve.parent = item


# Table, light and camera -----------------------------------------------------------------------


def _material(name: str, color: Vec3, roughness: float) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    material.diffuse_color = (*color, 1.0)
    return material


def _hand_material() -> bpy.types.Material:
    return bpy.data.materials.get("Hand") or _material("Hand", (0.58, 0.35, 0.24), 0.5)


def _add_table(context: bpy.types.Context) -> None:
    """Add a wooden table top: to the clay an endless plane."""
    corners = np.array([(x, y, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    top = _mesh_object("Table", 0.6 * corners, [(0, 1, 2, 3)])
    material = _material("Wood", (0.60, 0.40, 0.22), 0.38)
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
    make_collider(top, "PLANE", 0.6)


def _add_lights(context: bpy.types.Context) -> None:
    for name, place, energy, size, color in (
        ("Window", (-0.55, -0.05, 0.62), 7.5, 0.35, (1.0, 0.84, 0.66)),
        ("Lamp", (0.45, 0.55, 0.60), 4.0, 0.30, (1.0, 0.90, 0.78)),
    ):
        light = bpy.data.lights.new(name, "AREA")
        light.energy, light.size, light.color = energy, size, color
        item = bpy.data.objects.new(name, light)
        item.location = place
        item.rotation_euler = (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
        context.collection.objects.link(item)
    world = bpy.data.worlds.new("Room")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.80, 0.86, 1.0, 1.0)
    background.inputs["Strength"].default_value = 0.22
    context.scene.world = world


def _add_camera(context: bpy.types.Context) -> None:
    camera = bpy.data.cameras.new("Camera")
    camera.lens = 50.0
    item = bpy.data.objects.new("Camera", camera)
    item.location = (0.012, -0.425, 0.285)
    target = Vector((0.010, 0.012, 0.016))
    item.rotation_euler = (target - item.location).to_track_quat("-Z", "Y").to_euler()
    context.collection.objects.link(item)
    context.scene.camera = item


def _set_render(scene: bpy.types.Scene) -> None:
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 1080, 720
    scene.cycles.samples = 64
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = 5
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"


def _look_through_camera() -> None:
    """Let whoever opens the file see the table, in colour."""
    for screen in bpy.data.screens:
        for area in screen.areas:
            for space in area.spaces:
                if space.type == "VIEW_3D":
                    space.region_3d.view_perspective = "CAMERA"
                    space.shading.type = "MATERIAL"
