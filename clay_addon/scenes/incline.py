# SPDX-License-Identifier: GPL-3.0-or-later
"""The incline: four blocks of clay fall on a slope, three of them with one effect disabled.

Figure 2 of Barreiro, Torres and Otaduy, *Natural Tactile Interaction with Virtual Clay*, WHC 2021:
with the full model, the block lands and stops; without viscosity it flows fast and fractures;
without elastoplasticity it drifts; without friction it slides away. The paper disables one kind of
constraint per run. Here all four fall at once, in the extension's own clay model: in each block's
material, the parameter that corresponds to the constraint is zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians, tan
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...solver.scene.material import Material
from ..model.collider import make_collider
from .block import BOX_FACES, box_corners, clay_from
from .parts import mesh_object, plain_material
from .stage import (
    add_area_light,
    add_camera,
    add_room_light,
    look_through_camera,
    scene_preset,
    set_render,
    set_time_and_units,
)

FRAME_COUNT = int(scene_preset("incline")["frames"])

_BOARD = ((-0.80, -0.80), (0.50, 0.80))
"""Corners of the visible board along and across the slope [m]; as a collider it is infinite."""


@dataclass(frozen=True)
class Incline:
    """The objects of the scene."""

    clay: tuple[bpy.types.Object, ...]
    """The blocks: complete, without viscosity, without elastoplasticity, without friction."""
    board: bpy.types.Object
    """The slope."""


def build(
    context: bpy.types.Context,
    *,
    angle: float | None = None,
    friction: float | None = None,
    spacing: float | None = None,
) -> Incline:
    """Build the scene in an empty Blender scene, ready to bake and render.

    Args:
        context: The context with the scene to fill.
        angle: Angle of the slope [radians]; this and the others default to the preset.
        friction: Coulomb friction coefficient of slope and clay.
        spacing: Distance between particles [m].

    Raises:
        ClayError: The clay cannot be made; the message says why.
    """
    scene = context.scene
    data = scene_preset("incline")
    angle = radians(data["angle"]) if angle is None else angle
    friction = data["friction"] if friction is None else friction
    spacing = data["spacing"] if spacing is None else spacing
    scene.name = "Incline"
    set_time_and_units(scene, FRAME_COUNT)
    board = _add_board(context, angle, friction)
    base = replace(Material(**data["material"]), friction=friction)
    size = data["size"]
    # The block is level; its lowest corner is the fall height above the slope.
    height = data["fall"] + tan(angle) * size[0] / 2
    blocks = []
    for number, variant in enumerate(data["variant"]):
        across = (number - 0.5 * (len(data["variant"]) - 1)) * data["apart"]
        material = base
        if "without" in variant:
            material = replace(base, **{variant["without"]: 0.0})
        body = mesh_object(variant["label"], box_corners(size), BOX_FACES)
        body.location = (0.0, across, height)
        blocks.append(clay_from(context, body, spacing, material=material, color=variant["color"]))
        _add_label(context, variant, across, angle)
    for name, place, energy, light_size in (
        ("Window", (0.05, -0.85, 0.60), 13.0, 0.35),
        ("Lamp", (0.55, 0.70, 0.60), 2.5, 0.3),
    ):
        add_area_light(context, name, place, energy, light_size, (1.0, 0.94, 0.86))
    add_room_light(context, 0.2)
    add_camera(context, (0.56, -0.05, 0.36), (0.050, 0.0, -0.010), lens=44.0)
    set_render(scene, 1080, 640)
    look_through_camera(context)
    for block in blocks[1:]:
        block.select_set(False)
    context.view_layer.objects.active = blocks[0]
    return Incline(tuple(blocks), board)


def _on_slope(angle: float) -> Matrix:
    """Matrix from slope coordinates, with x downhill, to world coordinates."""
    return Matrix.Rotation(angle, 4, "Y")


def _add_board(context: bpy.types.Context, angle: float, friction: float) -> bpy.types.Object:
    (left, low), (right, high) = _BOARD
    corners = np.array([(left, low, 0), (right, low, 0), (right, high, 0), (left, high, 0)])
    board = mesh_object("Slope", corners, [(0, 1, 2, 3)])
    board.matrix_world = _on_slope(angle)
    board.data.materials.append(plain_material("Slope", (0.42, 0.40, 0.37), 0.6))
    context.view_layer.update()
    return make_collider(board, "PLANE", friction)


def _add_label(
    context: bpy.types.Context, variant: dict[str, Any], across: float, angle: float
) -> None:
    """Add a label uphill of a block, readable from downhill."""
    text = bpy.data.curves.new(variant["label"], "FONT")
    text.body = variant["label"]
    text.size, text.align_x, text.align_y = 0.015, "CENTER", "CENTER"
    text.materials.append(plain_material(f"{variant['label']} label", variant["color"], 0.5))
    item = bpy.data.objects.new(f"{variant['label']} label", text)
    context.collection.objects.link(item)
    flat = Matrix(((0, -1, 0, -0.105), (1, 0, 0, across), (0, 0, 1, 0.0005), (0, 0, 0, 1)))
    item.matrix_world = _on_slope(angle) @ flat
