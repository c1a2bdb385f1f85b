# SPDX-License-Identifier: GPL-3.0-or-later
"""What the ready-made scenes share: their data, a table, lights, a camera, and how they show."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

from ..base.units import from_meters
from ..model.collider import make_collider
from .parts import Vec3, mesh_object, plain_material

_PRESET_FOLDER = Path(__file__).resolve().parents[2] / "presets" / "scenes"

FRAMES_PER_SECOND = 60
"""Of the scenes that move."""

_TABLE_HALF = 0.3
"""Half the side of a table top [m]; to the clay it has no end."""
_TABLE_FRICTION = 0.8


def scene_preset(name: str) -> dict[str, Any]:
    """The data of a scene: ``presets/scenes/NAME.toml``."""
    return tomllib.loads((_PRESET_FOLDER / f"{name}.toml").read_text(encoding="utf-8"))


def add_table(context: bpy.types.Context, place: Sequence[float]) -> bpy.types.Object:
    """Add a table top: to the clay an infinite plane.

    Args:
        context: Its collection takes it.
        place: The top's middle [Blender units].
    """
    half = from_meters(context.scene, _TABLE_HALF)
    corners = half * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float64)
    top = mesh_object("Table", corners, [(0, 1, 2, 3)])
    top.location = place
    top.data.materials.append(plain_material("Table", (0.60, 0.40, 0.22), 0.5))
    context.view_layer.update()
    return make_collider(top, "PLANE", _TABLE_FRICTION)


def add_area_light(
    context: bpy.types.Context, name: str, place: Vec3, energy: float, size: float, color: Vec3
) -> bpy.types.Object:
    """Add a square light that looks at the world's origin.

    Args:
        context: Its collection takes it.
        name: Of the light.
        place: Where it is [m].
        energy: Power [W].
        size: Side [m].
        color: Linear RGB.
    """
    light = bpy.data.lights.new(name, "AREA")
    light.energy, light.size, light.color = energy, size, color
    item = bpy.data.objects.new(name, light)
    item.location = place
    item.rotation_euler = (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
    context.collection.objects.link(item)
    return item


def add_room_light(context: bpy.types.Context, strength: float) -> None:
    """Light the scene evenly with a little of a blueish white."""
    world = bpy.data.worlds.new("Room")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.80, 0.86, 1.0, 1.0)
    background.inputs["Strength"].default_value = strength
    context.scene.world = world


def add_camera(
    context: bpy.types.Context, place: Vec3, target: Vec3, *, lens: float = 50.0
) -> bpy.types.Object:
    """Add the scene's camera.

    Args:
        context: Its scene takes it.
        place: Where it is [m].
        target: What it looks at [m].
        lens: Focal length [mm].
    """
    camera = bpy.data.cameras.new("Camera")
    camera.lens = lens
    item = bpy.data.objects.new("Camera", camera)
    item.location = place
    item.rotation_euler = (Vector(target) - item.location).to_track_quat("-Z", "Y").to_euler()
    context.collection.objects.link(item)
    context.scene.camera = item
    return item


def set_clock_and_units(scene: bpy.types.Scene, frame_count: int) -> None:
    """Let a scene run from frame 1, in centimeters."""
    scene.frame_start, scene.frame_end = 1, frame_count
    scene.frame_set(1)
    scene.render.fps, scene.render.fps_base = FRAMES_PER_SECOND, 1.0
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.length_unit = "CENTIMETERS"


def set_render(scene: bpy.types.Scene, width: int, height: int) -> None:
    """Render with Cycles, at a size [pixels] and a number of samples that show clay well."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.cycles.samples = 64
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = 5
    scene.cycles.caustics_reflective = scene.cycles.caustics_refractive = False
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"


def look_through_camera(context: bpy.types.Context) -> None:
    """Let whoever sees the scene see it through its camera, in color."""
    # A file made without a window is opened with any of its workspaces.
    screens = [context.screen] if context.screen else bpy.data.screens
    for screen in screens:
        for area in screen.areas:
            for space in area.spaces:
                if space.type == "VIEW_3D":
                    space.region_3d.view_perspective = "CAMERA"
                    space.shading.type = "MATERIAL"


def look_at(context: bpy.types.Context, center: Sequence[float], size: float) -> None:
    """Bring something into the 3D view in use, if it would be a speck or out of sight there.

    Args:
        context: Its region is that of the view; elsewhere nothing happens.
        center: Its middle [Blender units].
        size: How large it is [Blender units].
    """
    view = context.region_data
    if not isinstance(view, bpy.types.RegionView3D):
        return
    away = (view.view_location - Vector(center)).length
    if view.view_perspective == "CAMERA":
        view.view_perspective = "PERSP"
    if not 1.5 * size < view.view_distance < 10 * size or away > 0.5 * view.view_distance:
        view.view_location = center
        view.view_distance = 4 * size
