# SPDX-License-Identifier: GPL-3.0-or-later
"""The potter's wheel scene: two hands throw a pot from a lump of clay.

After figure 7 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021: 4,169 particles on a wheel that turns at 100 rpm. The wheel speeds up, the hands center
the lump, open it and raise its wall, and the wheel slows down again.

Everything is an ordinary object with modifiers, armatures and keyframes, and can be edited.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau

import bpy
import numpy as np
from mathutils import Vector, noise

from ...solver.geometry.closed_mesh import mesh_volume
from ..base.mesh_geometry import evaluated_mesh
from ..clay.make_clay import make_clay
from ..model.collider import make_collider
from .parts import mesh_object, plain_material
from .stage import (
    add_area_light,
    add_camera,
    add_room_light,
    look_through_camera,
    set_render,
    set_time_and_units,
)
from .wheel_hands import LAST_FRAME, WHEEL_SPEEDS, add_hands

PARTICLE_COUNT = 4169
"""Number of particles, as in the paper's wheel scene."""
SPACING = 0.005
"""Distance between particles [m]."""
FRAME_COUNT = LAST_FRAME
FRAMES_PER_SECOND = 30
WHEEL_RADIUS = 0.13
"""Radius of the wheel head [m]."""
_WHEEL_FRICTION = 2.5
_WHEEL_ADHESION = 60000.0
"""High, as wet clay sticks to a wheel head: it takes a wire to cut a pot off [Pa]."""
_CLAY_COLOR = (0.36, 0.165, 0.085)
"""Linear RGB of red earthenware."""


_LIGHTS = (
    ("Window", (-0.60, -0.20, 0.60), 10.0, 0.35, (1.0, 0.90, 0.78)),
    ("Lamp", (0.55, 0.45, 0.55), 7.0, 0.25, (1.0, 0.86, 0.70)),
)


@dataclass(frozen=True)
class WheelScene:
    """The objects of the scene."""

    clay: bpy.types.Object
    """The clay, a point cloud."""
    lump: bpy.types.Object
    """The mesh it was made from, hidden."""
    wheel: bpy.types.Object
    """The wheel head, with keyframed speed."""
    hands: tuple[bpy.types.Object, ...]
    """The right and the left clay hand, with keyframes."""


def build(context: bpy.types.Context) -> WheelScene:
    """Build the scene in an empty Blender scene, ready to bake and render.

    Args:
        context: The context with the scene to fill.
    """
    scene = context.scene
    scene.name = "Potter's wheel"
    set_time_and_units(scene, FRAME_COUNT)
    scene.render.fps = FRAMES_PER_SECOND
    wheel = _add_wheel(context)
    lump = _add_lump(context)
    clay = make_clay(context, [lump], SPACING, "throwing_clay", "Throwing clay")
    # Softer than the preset: it has been kneaded, and water is added while it is thrown.
    properties = clay.tactile_clay
    properties.yield_stress, properties.shear_modulus = 5000.0, 250000.0
    properties.viscosity = 200.0
    _key_speed(wheel)
    hands = add_hands(context)
    _add_pan()
    _add_room(context)
    for name, place, energy, size, color in _LIGHTS:
        add_area_light(context, name, place, energy, size, color)
    add_room_light(context, 0.25)
    add_camera(context, (0.17, -0.54, 0.36), (0.0, 0.0, 0.040))
    set_render(scene, 1080, 720)
    look_through_camera(context)
    return WheelScene(clay, lump, wheel, hands)


def _add_lump(context: bpy.types.Context) -> bpy.types.Object:
    """Add a ball of clay on the wheel, not quite round and not quite centered."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, radius=1.0)
    item = context.object
    item.name = item.data.name = "Lump"
    for vertex in item.data.vertices:
        bump = noise.noise(1.3 * vertex.co + Vector((3.1, 0.4, 7.7)))
        vertex.co *= 1.0 + 0.10 * bump
        vertex.co.z = 0.56 * max(vertex.co.z, -0.6)
    item.data.materials.append(plain_material("Wet earthenware", _CLAY_COLOR, 0.4))
    context.view_layer.update()
    vertices, triangles = evaluated_mesh(item, context.evaluated_depsgraph_get())
    factor = (PARTICLE_COUNT * SPACING**3 / mesh_volume(vertices, triangles)) ** (1 / 3)
    item.scale = (factor,) * 3
    item.location = (0.003, -0.002, -factor * float(vertices[:, 2].min()))
    context.view_layer.update()
    return item


def _key_speed(wheel: bpy.types.Object) -> None:
    properties = wheel.tactile_clay
    for frame, speed in WHEEL_SPEEDS:
        properties.wheel_speed = speed
        properties.keyframe_insert("wheel_speed", frame=frame)


def _lathed(
    name: str, profile: Sequence[tuple[float, float]], segments: int = 96
) -> bpy.types.Object:
    """Add a closed solid of revolution.

    Args:
        name: Name of the object.
        profile: Radius and height [m], from the axis at the bottom to the axis at the top.
        segments: Number of segments around the axis.
    """
    angles = np.linspace(0.0, tau, segments, endpoint=False)
    inner = profile[1:-1]
    rings = [
        np.stack([r * np.cos(angles), r * np.sin(angles), np.full(segments, z)], axis=1)
        for r, z in inner
    ]
    vertices = np.concatenate([*rings, [(0, 0, profile[0][1])], [(0, 0, profile[-1][1])]])
    bottom, top = len(vertices) - 2, len(vertices) - 1
    faces: list[tuple[int, ...]] = []
    for n in range(segments):
        m = (n + 1) % segments
        faces.append((bottom, m, n))
        for ring in range(len(inner) - 1):
            a, b = segments * ring, segments * (ring + 1)
            faces.append((a + n, a + m, b + m, b + n))
        last = segments * (len(inner) - 1)
        faces.append((top, last + n, last + m))
    return mesh_object(name, vertices, faces)


def _add_pan() -> None:
    """Add the splash pan around the wheel head; it does not touch the clay."""
    pan = _lathed(
        "Splash pan",
        (
            (0.0, -0.075),
            (0.185, -0.075),
            (0.196, -0.068),
            (0.203, -0.016),
            (0.210, -0.013),
            (0.214, -0.016),
            (0.212, -0.022),
            (0.204, -0.075),
            (0.190, -0.086),
            (0.0, -0.086),
        ),
    )
    # This profile runs up the inside and down the outside, so its faces point inward.
    pan.data.flip_normals()
    pan.data.shade_smooth()
    pan.modifiers.new("Soft", "SUBSURF").render_levels = 1
    pan.data.materials.append(plain_material("Blue plastic", (0.035, 0.115, 0.20), 0.32))


def _add_room(context: bpy.types.Context) -> None:
    """Add a bench below the wheel head, as background."""
    corners = np.array([(x, y, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    floor = mesh_object("Bench", 3.0 * corners + (0.0, 0.0, -0.10), [(0, 1, 2, 3)])
    floor.data.materials.append(plain_material("Bench", (0.42, 0.36, 0.30), 0.7))


def _metal() -> bpy.types.Material:
    """Metal with blotches of slip, which make its rotation visible."""
    material = plain_material("Wheel head", (0.52, 0.53, 0.54), 0.35)
    tree = material.node_tree
    shader = tree.nodes["Principled BSDF"]
    place = tree.nodes.new("ShaderNodeTexCoord")
    blotches = tree.nodes.new("ShaderNodeTexNoise")
    blotches.inputs["Scale"].default_value = 26.0
    blotches.inputs["Detail"].default_value = 4.0
    blotches.inputs["Distortion"].default_value = 0.8
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    low, high = ramp.color_ramp.elements
    low.position, high.position = 0.54, 0.62
    low.color, high.color = (0.44, 0.45, 0.46, 1.0), (0.30, 0.20, 0.145, 1.0)
    tree.links.new(place.outputs["Object"], blotches.inputs["Vector"])
    tree.links.new(blotches.outputs[0], ramp.inputs["Fac"])
    tree.links.new(ramp.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Metallic"].default_value = 0.35
    return material


def _add_wheel(context: bpy.types.Context) -> bpy.types.Object:
    """Add the wheel head, whose upper face is at height 0."""
    edge = 0.003
    wheel = _lathed(
        "Wheel head",
        (
            (0.0, -0.016),
            (WHEEL_RADIUS - edge, -0.016),
            (WHEEL_RADIUS, -0.016 + edge),
            (WHEEL_RADIUS, -edge),
            (WHEEL_RADIUS - edge, 0.0),
            (0.0, 0.0),
        ),
    )
    wheel.data.materials.append(_metal())
    make_collider(wheel, "MESH", _WHEEL_FRICTION)
    wheel.tactile_clay.collider_adhesion = _WHEEL_ADHESION
    return wheel
