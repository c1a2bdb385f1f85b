# SPDX-License-Identifier: GPL-3.0-or-later
"""The shader of clay, built from Blender's own nodes."""

from __future__ import annotations

from typing import Any

import bpy

from ..base.surface_mesh import COLOR_ATTRIBUTE, SPACING_ATTRIBUTE, TEXTURE_ATTRIBUTE

MATERIAL_NAME = "Clay"
MARK = "tactile_clay_look"
"""Custom property that marks our materials and node groups, to leave the user's own alone."""
VERSION = 2
"""Value of the mark; data with another value is not reused."""


def clay_material() -> bpy.types.Material:
    """The material shared by all clay, created at the first call.

    Its color is the attribute ``Color`` of the surface or the points.
    """
    for material in bpy.data.materials:
        if material.get(MARK) == VERSION and material.library is None:
            return material
    material = bpy.data.materials.new(MATERIAL_NAME)
    material[MARK] = VERSION
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.diffuse_color = (0.72, 0.36, 0.22, 1.0)
    tree = material.node_tree
    tree.nodes.clear()
    color = add_node(tree, "ShaderNodeAttribute", (-800, 200))
    color.name = color.label = color.attribute_name = COLOR_ATTRIBUTE
    place = add_node(tree, "ShaderNodeAttribute", (-1200, -200))
    place.name = place.label = place.attribute_name = TEXTURE_ATTRIBUTE
    spacing = add_node(tree, "ShaderNodeAttribute", (-1000, -600))
    spacing.name = spacing.label = spacing.attribute_name = SPACING_ATTRIBUTE
    normal = None
    # Shallow dents like thumb marks, then the fine grain of the clay.
    for x, scale, detail, depth in ((-600, 0.22, 2.0, 0.6), (-350, 1.6, 5.0, 0.035)):
        noise = add_node(tree, "ShaderNodeTexNoise", (x - 200, -150), Scale=scale, Detail=detail)
        tree.links.new(place.outputs["Vector"], noise.inputs["Vector"])
        height = add_node(tree, "ShaderNodeMath", (x - 200, -500))
        height.operation = "MULTIPLY"
        tree.links.new(spacing.outputs["Fac"], height.inputs[0])
        height.inputs[1].default_value = depth
        bump = add_node(tree, "ShaderNodeBump", (x, -150), Strength=1.0)
        tree.links.new(noise.outputs[0], bump.inputs["Height"])
        tree.links.new(height.outputs[0], bump.inputs["Distance"])
        if normal is not None:
            tree.links.new(normal, bump.inputs["Normal"])
        normal = bump.outputs["Normal"]
    shader = add_node(
        tree,
        "ShaderNodeBsdfPrincipled",
        (-100, 200),
        **{
            "Roughness": 0.6,
            "Specular IOR Level": 0.3,
            "Subsurface Weight": 0.08,
            "Subsurface Scale": 0.002,
            "Subsurface Radius": (1.0, 0.6, 0.4),
            "Sheen Weight": 0.04,
            "Sheen Roughness": 0.6,
        },
    )
    tree.links.new(color.outputs["Color"], shader.inputs["Base Color"])
    tree.links.new(normal, shader.inputs["Normal"])
    output = add_node(tree, "ShaderNodeOutputMaterial", (250, 200))
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def add_node(tree: bpy.types.NodeTree, kind: str, place: tuple[float, float], **values: Any) -> Any:
    """Add a node and set its inputs by name."""
    node = tree.nodes.new(kind)
    node.location = place
    for name, value in values.items():
        node.inputs[name].default_value = value
    return node
