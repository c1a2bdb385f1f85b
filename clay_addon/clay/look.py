# SPDX-License-Identifier: GPL-3.0-or-later
"""The look of clay: its material, and a surface in the viewport and in renders.

All of it is made of Blender's own nodes, so a .blend displays and renders without the add-on.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ..base.surface_mesh import fill_surface_mesh
from ..core.surface.exact import Surface
from .look_material import clay_material
from .look_surface import surface_group

MODIFIER_NAME = "Clay Surface"


def add_look(clay: bpy.types.Object, *, spacing: float | None = None) -> bpy.types.Modifier:
    """Show a clay object as a smooth, colored surface.

    Adds the modifier "Clay Surface" at the end of the stack unless there is one, and the clay
    material. The modifier's *Surface* switches between surface and points; above *Viewport Limit*
    particles, the viewport shows points and only renders show the surface.

    Args:
        clay: Point cloud object with the attributes ``radius`` and ``Color``.
        spacing: Distance between particles [Blender units]; by default twice the first radius.

    Returns:
        The modifier.

    Raises:
        ValueError: The object is not a point cloud, or its spacing is unknown or not positive.
    """
    if clay.type != "POINTCLOUD":
        raise ValueError(f"{clay.name!r} is a {clay.type.lower()}, not a point cloud of clay.")
    if spacing is None:
        radius = clay.data.attributes.get("radius")
        if radius is None or len(radius.data) == 0:
            raise ValueError(f"{clay.name!r} has no particle radius; give the spacing.")
        spacing = 2 * radius.data[0].value
    if not spacing > 0:
        raise ValueError(f"The spacing of {clay.name!r} must be above 0, got {spacing:g}.")
    material = clay_material()
    if not any(slot == material for slot in clay.data.materials):
        clay.data.materials.append(material)
    modifier = clay.modifiers.get(MODIFIER_NAME)
    if modifier is None:
        modifier = clay.modifiers.new(MODIFIER_NAME, "NODES")
        modifier.node_group = surface_group()
    set_input(modifier, "Spacing", spacing)
    set_input(modifier, "Material", material)
    return modifier


def surface_object(
    surface: Surface, name: str, *, spacing: float | None = None
) -> bpy.types.Object:
    """Make a smooth-shaded mesh object from a reconstructed surface, with the clay material.

    The object is not linked to a collection.

    Args:
        surface: The surface from `reconstruct`.
        name: Name of the object.
        spacing: Distance between particles [Blender units], for the grain of the material; by
            default estimated from the mesh.
    """
    mesh = bpy.data.meshes.new(name)
    if spacing is None:
        sides = surface.vertices[surface.faces[:, 0]] - surface.vertices[surface.faces[:, 1]]
        # The median edge of the reconstruction is 0.41 spacings.
        spacing = float(np.median(np.linalg.norm(sides, axis=1))) / 0.41
    fill_surface_mesh(mesh, surface.vertices, surface.faces, spacing=spacing, colors=surface.colors)
    mesh.materials.append(clay_material())
    return bpy.data.objects.new(name, mesh)


def show_colors() -> None:
    """Switch solid 3D views from material colors, Blender's default, to attribute colors.

    They then show the clay's own colors; other objects look as before.
    """
    for screen in bpy.data.screens:
        for area in screen.areas:
            for space in area.spaces:
                if space.type == "VIEW_3D" and space.shading.color_type == "MATERIAL":
                    space.shading.color_type = "VERTEX"


def set_input(modifier: bpy.types.Modifier, name: str, value: Any) -> None:
    """Set an input of a geometry nodes modifier by name.

    Raises:
        KeyError: The modifier has no such input.
    """
    identifier = _input_identifier(modifier, name)
    if bpy.app.version < (5, 2, 0):
        modifier[identifier] = value
    else:
        getattr(modifier.properties.inputs, identifier).value = value
    modifier.id_data.update_tag()


def get_input(modifier: bpy.types.Modifier, name: str) -> Any:
    """Return an input of a geometry nodes modifier by name.

    Raises:
        KeyError: The modifier has no such input.
    """
    identifier = _input_identifier(modifier, name)
    if bpy.app.version < (5, 2, 0):
        return modifier[identifier]
    return getattr(modifier.properties.inputs, identifier).value


def input_path(modifier: bpy.types.Modifier, name: str) -> str:
    """The data path of a modifier's input, relative to the object, for keyframes.

    Raises:
        KeyError: The modifier has no such input.
    """
    identifier = _input_identifier(modifier, name)
    path = f'modifiers["{bpy.utils.escape_identifier(modifier.name)}"]'
    if bpy.app.version < (5, 2, 0):
        return f'{path}["{identifier}"]'
    return f"{path}.properties.inputs.{identifier}.value"


def _input_identifier(modifier: bpy.types.Modifier, name: str) -> str:
    for item in modifier.node_group.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == name:
            return str(item.identifier)
    raise KeyError(f"{modifier.name!r} has no input {name!r}.")
