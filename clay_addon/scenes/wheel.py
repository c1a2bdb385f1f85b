# SPDX-License-Identifier: GPL-3.0-or-later
"""The potter's wheel scene: two hands throw a pot from a lump of clay.

After figure 7 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021: 4,169 particles on a wheel that turns 100 times a minute. The pedal is pressed, the hands
center the lump, open it, and raise its wall; then the pedal is let go.

All of it are ordinary objects with modifiers, armatures and keyframes, to be changed by hand.
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
    set_clock_and_units,
    set_render,
)
from .wheel_hands import LAST_FRAME, PEDAL, add_hands

PARTICLE_COUNT = 4169
"""As many particles as the paper's wheel scene has."""
SPACING = 0.005
"""Distance between particles [m]."""
FRAME_COUNT = LAST_FRAME
FRAMES_PER_SECOND = 30
WHEEL_RADIUS = 0.13
"""Of the wheel head [m]."""
_WHEEL_FRICTION = 2.5
_WHEEL_ADHESION = 60000.0
"""Wet clay sticks to a wheel head: it takes a wire to cut a pot off [Pa]."""
_CLAY_COLOR = (0.36, 0.165, 0.085)
"""Of red earthenware, linear RGB."""


_LIGHTS = (
    ("Window", (-0.60, -0.20, 0.60), 10.0, 0.35, (1.0, 0.90, 0.78)),
    ("Lamp", (0.55, 0.45, 0.55), 7.0, 0.25, (1.0, 0.86, 0.70)),
)


@dataclass(frozen=True)
class WheelScene:
    """What the scene is made of."""

    clay: bpy.types.Object
    """The clay, a point cloud."""
    lump: bpy.types.Object
    """The mesh it was made from, hidden."""
    wheel: bpy.types.Object
    """The wheel head; its speed is keyed."""
    hands: tuple[bpy.types.Object, ...]
    """The right and the left clay hand, keyed."""


def build(context: bpy.types.Context) -> WheelScene:
    """Build the scene into an empty Blender scene, ready to bake and to render.

    Args:
        context: Its scene is filled.
    """
    scene = context.scene
    scene.name = "Potter's wheel"
    set_clock_and_units(scene, FRAME_COUNT)
    scene.render.fps = FRAMES_PER_SECOND
    wheel = _add_wheel(context)
    lump = _add_lump(context)
    clay = make_clay(context, [lump], SPACING, "throwing_clay", "Throwing clay")
    # Softer than from the bag: it has been kneaded, and water is added while it is thrown.
    properties = clay.tactile_clay
    properties.yield_stress, properties.shear_modulus = 5000.0, 250000.0
    properties.viscosity = 200.0
    _press_pedal(wheel)
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
    """A ball of clay thrown onto the wheel, not quite round and not quite centered."""
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


def _press_pedal(wheel: bpy.types.Object) -> None:
    properties = wheel.tactile_clay
    for frame, speed in PEDAL:
        properties.wheel_speed = speed
        properties.keyframe_insert("wheel_speed", frame=frame)


def _lathed(
    name: str, profile: Sequence[tuple[float, float]], segments: int = 96
) -> bpy.types.Object:
    """A closed solid of revolution.

    Args:
        name: Of the object.
        profile: Radius and height [m], from the axis at the bottom to the axis at the top.
        segments: Around the axis.
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
    # From the bottom up outside, and down inside: the profile runs the other way round.
    pan.data.flip_normals()
    pan.data.shade_smooth()
    pan.modifiers.new("Soft", "SUBSURF").render_levels = 1
    pan.data.materials.append(plain_material("Blue plastic", (0.035, 0.115, 0.20), 0.32))


def _add_room(context: bpy.types.Context) -> None:
    """Add the table behind, far below the wheel head."""
    corners = np.array([(x, y, 0.0) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    floor = mesh_object("Bench", 3.0 * corners + (0.0, 0.0, -0.10), [(0, 1, 2, 3)])
    floor.data.materials.append(plain_material("Bench", (0.42, 0.36, 0.30), 0.7))


def _metal() -> bpy.types.Material:
    """Turned metal with a film of slip, in blotches, so that its turning shows."""
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
