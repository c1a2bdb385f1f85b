# SPDX-License-Identifier: GPL-3.0-or-later
"""Light, camera and render settings of a scene that the extension comes with."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
from mathutils import Vector

from .kindergarten_parts import Vec3


def set_stage(
    context: bpy.types.Context,
    *,
    camera: tuple[Vec3, Vec3],
    lights: Sequence[tuple[str, Vec3, float, float, Vec3]],
) -> None:
    """Light a scene, look at it, and set how it is rendered.

    Args:
        context: Its scene is lit.
        camera: Where the camera is and what it looks at [m].
        lights: Name, place [m], power [W], size [m] and linear RGB of each; all look at the origin.
    """
    for name, place, energy, size, color in lights:
        light = bpy.data.lights.new(name, "AREA")
        light.energy, light.size, light.color = energy, size, color
        _look(context, bpy.data.objects.new(name, light), place, (0.0, 0.0, 0.0))
    world = bpy.data.worlds.new("Room")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.80, 0.86, 1.0, 1.0)
    background.inputs["Strength"].default_value = 0.22
    scene = context.scene
    scene.world = world
    lens = bpy.data.cameras.new("Camera")
    lens.lens = 50.0
    scene.camera = _look(context, bpy.data.objects.new("Camera", lens), *camera)
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = 1080, 720
    scene.cycles.samples = 64
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = 5
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    for screen in bpy.data.screens:
        for area in screen.areas:
            for space in area.spaces:
                if space.type == "VIEW_3D":
                    space.region_3d.view_perspective = "CAMERA"
                    space.shading.type = "MATERIAL"


def _look(
    context: bpy.types.Context, item: bpy.types.Object, place: Vec3, target: Vec3
) -> bpy.types.Object:
    item.location = place
    item.rotation_euler = (Vector(target) - Vector(place)).to_track_quat("-Z", "Y").to_euler()
    context.collection.objects.link(item)
    return item
