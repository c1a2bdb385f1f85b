# SPDX-License-Identifier: GPL-3.0-or-later
"""A block of clay on a table, and helpers for other ready-made clay."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.scene.material import Material
from ..base.units import from_meters, meters_per_unit
from ..clay.make_clay import make_clay
from ..clay.meshes import ClayError
from ..model.clay_scene import clay_objects, collider_objects
from ..model.material_properties import write_material
from .parts import mesh_object, plain_material
from .stage import add_table, scene_preset

BOX_FACES = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
"""Faces of a box whose corners are ordered as in `box_corners`."""


def box_corners(size: Sequence[float]) -> NDArray[np.float64]:
    """Corners of a box that stands on the origin, shape [8, 3].

    The four lower ones come first; both fours are counter-clockwise seen from above.
    """
    corners = [
        (x, y, z)
        for z in (0.0, 1.0)
        for x, y in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    ]
    return np.array(corners) * np.array(size, np.float64)


def new_spacing(scene: bpy.types.Scene, spacing: float, preset: float) -> float:
    """The spacing for new clay in a scene [Blender units].

    Args:
        scene: The scene.
        spacing: Requested spacing [Blender units]; 0 for none in particular.
        preset: Spacing if neither the scene's clay nor its settings specify one [m].

    Raises:
        ClayError: The scene's clay has a spacing other than the requested one.
    """
    existing = clay_objects(scene)
    if not existing:
        chosen = scene.tactile_clay.spacing_chosen
        return spacing or chosen or from_meters(scene, preset)
    common = float(existing[0].tactile_clay.spacing)
    if spacing and abs(spacing - common) > 1e-6 * common:
        millimeters = 1e3 * meters_per_unit(scene)
        raise ClayError(
            f"All clay of a scene needs the same spacing: {existing[0].name!r} has "
            f"{common * millimeters:.3g} mm, not {spacing * millimeters:.3g} mm. Use the same "
            "spacing, or remove the other clay."
        )
    return common


def clay_from(
    context: bpy.types.Context,
    body: bpy.types.Object,
    spacing: float,
    *,
    preset: str | None = None,
    material: Material | None = None,
    color: Sequence[float],
) -> bpy.types.Object:
    """Make clay from one mesh; on failure, the mesh is deleted.

    Args:
        context: Its scene and active collection get the clay.
        body: A closed mesh object, which is kept but hidden.
        spacing: Distance between particles [Blender units].
        preset: Name of a material preset; by default the scene's.
        material: Custom values that replace those of the preset.
        color: Linear RGB.

    Raises:
        ClayError: It cannot be made; the message says why.
    """
    mesh = body.data
    mesh.materials.append(plain_material(body.name, (color[0], color[1], color[2]), 0.6))
    context.view_layer.update()
    name = body.name
    body.name = mesh.name = f"{name} shape"
    try:
        clay = make_clay(context, [body], spacing, preset, name)
    except ClayError:
        bpy.data.meshes.remove(mesh)
        raise
    if material is not None:
        write_material(clay.tactile_clay, material)
    return clay


def add_block(
    context: bpy.types.Context,
    *,
    size: float = 0.0,
    spacing: float = 0.0,
    preset: str | None = None,
    table: bool = True,
) -> bpy.types.Object:
    """Add a cube of clay on the 3D cursor.

    Args:
        context: Its collection gets the cube.
        size: Edge length [Blender units]; 0 for about 4,000 particles.
        spacing: Distance between particles [Blender units]; 0 for that of the scene's clay.
        preset: Name of a material preset; by default the scene's.
        table: Whether to add a table if the scene has no collider.

    Returns:
        The clay.

    Raises:
        ClayError: It cannot be made; the message says why, and nothing has changed.
    """
    scene = context.scene
    data = scene_preset("block")
    spacing = new_spacing(scene, spacing, data["spacing"])
    size = size or spacing * data["size"] / data["spacing"]
    body = mesh_object("Clay block", box_corners((size, size, size)), BOX_FACES)
    body.location = scene.cursor.location
    clay = clay_from(context, body, spacing, preset=preset, color=data["color"])
    if table and not collider_objects(scene):
        add_table(context, scene.cursor.location)
        _select_alone(context, clay)
    return clay


def _select_alone(context: bpy.types.Context, item: bpy.types.Object) -> None:
    for other in context.selected_objects:
        other.select_set(False)
    item.select_set(True)
    context.view_layer.objects.active = item
