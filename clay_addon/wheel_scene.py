# SPDX-License-Identifier: GPL-3.0-or-later
"""The potter's wheel scene: two hands throw a pot from a lump of clay.

After figure 7 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*,
WHC 2021: 4,169 particles on a wheel that turns 100 times a minute. The pedal is pressed, the hands
centre the lump, open it, and raise its wall; then the pedal is let go.

All of it are ordinary objects with modifiers, armatures and keyframes, to be changed by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import radians, tau

import bpy
import numpy as np
from mathutils import Vector, noise

from ..solver.closed_mesh import mesh_volume
from .collider import make_collider
from .kindergarten_parts import Vec3, mesh_object, plain_material
from .make_clay import make_clay
from .mesh_geometry import evaluated_mesh
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
_WHEEL_ADHESION = 30000.0
"""Wet clay sticks to a wheel head: it takes a wire to cut a pot off [Pa]."""
_CLAY_COLOR = (0.36, 0.165, 0.085)
"""Of red earthenware, linear RGB."""


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
    scene.frame_start, scene.frame_end = 1, FRAME_COUNT
    scene.frame_set(1)
    scene.render.fps, scene.render.fps_base = FRAMES_PER_SECOND, 1.0
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.length_unit = "CENTIMETERS"
    wheel = _add_wheel(context)
    lump = _add_lump(context)
    clay = make_clay(context, [lump], SPACING, "throwing_clay", "Throwing clay")
    # Softer than from the bag: it has been kneaded, and water is added while it is thrown.
    properties = clay.tactile_clay
    properties.yield_stress, properties.shear_modulus = 5000.0, 250000.0
    properties.viscosity = 200.0
    _press_pedal(wheel)
    hands = add_hands(context)
    return WheelScene(clay, lump, wheel, hands)


def _add_lump(context: bpy.types.Context) -> bpy.types.Object:
    """A ball of clay thrown onto the wheel, not quite round and not quite centred."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, radius=1.0)
    item = context.object
    item.name = item.data.name = "Lump"
    for vertex in item.data.vertices:
        bump = noise.noise(1.3 * vertex.co + Vector((3.1, 0.4, 7.7)))
        vertex.co *= 1.0 + 0.10 * bump
        vertex.co.z = 0.72 * max(vertex.co.z, -0.6)
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
    make_collider(wheel, "MESH", _WHEEL_FRICTION)
    wheel.tactile_clay.collider_adhesion = _WHEEL_ADHESION
    return wheel
