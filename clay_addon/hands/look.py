# SPDX-License-Identifier: GPL-3.0-or-later
"""The default hand's material: skin with fingernails that are shaded, not modeled.

Nails are finer than the skin's triangles. Each vertex of a fingertip therefore stores its position
in the nail's frame, from which the material computes a sharp outline for every pixel.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.hand.skinned_hand import SkinnedHand

_MATERIAL = "Clay hand"
_NAIL = "nail"
_SKIN_COLOR = (0.56, 0.33, 0.23, 1.0)
_NAIL_COLOR = (0.70, 0.44, 0.36, 1.0)
_EDGE_COLOR = (0.80, 0.66, 0.56, 1.0)
_NO_NAIL = (9.0, 9.0, -9.0)
"""Nail coordinates of vertices far from every nail."""


def add_hand_look(mesh: bpy.types.Mesh, hand: SkinnedHand) -> None:
    """Give the default hand its material and nail coordinates.

    Args:
        mesh: Mesh with the hand's vertices in the same order.
        hand: The default hand.
    """
    mesh.materials.append(_material())
    layer = mesh.attributes.new(_NAIL, "FLOAT_VECTOR", "POINT")
    layer.data.foreach_set("vector", nail_coordinates(hand).astype(np.float32).ravel())


def nail_coordinates(hand: SkinnedHand) -> NDArray[np.float64]:
    """Coordinates of each vertex in the frame of its finger's nail, shape [V, 3].

    A nail extends from -1 to 1 across and along the finger; the third coordinate is the height
    above the bone in radii of the fingertip.
    """
    coordinates = np.tile(np.array(_NO_NAIL), (len(hand.vertices), 1))
    for bone, name in enumerate(hand.bone_names):
        if not name.endswith("distal"):
            continue
        finger = name.split("_")[0]
        own = hand.weights[
            :, [n.startswith(finger) and not n.endswith("metacarpal") for n in hand.bone_names]
        ].sum(1)
        tip = np.flatnonzero((own > 0.5) & (hand.weights[:, bone] > 0.02))
        local = hand.vertices[tip] - hand.bone_rest[bone, :3, 3]
        across, up, back = (local @ hand.bone_rest[bone, :3, :3]).T
        length = float((-back).max())
        radius = float(np.abs(across[-back > 0.4 * length]).max())
        coordinates[tip] = np.column_stack(
            [across / (0.70 * radius), (-back - 0.68 * length) / (0.26 * length), up / radius]
        )
    return coordinates


def _material() -> bpy.types.Material:
    material = bpy.data.materials.get(_MATERIAL)
    if material is not None:
        return material
    material = bpy.data.materials.new(_MATERIAL)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.diffuse_color = _SKIN_COLOR
    tree = material.node_tree
    shader = tree.nodes["Principled BSDF"]
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = _NAIL
    components = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(attribute.outputs["Vector"], components.inputs["Vector"])
    across, along, up = components.outputs

    def math(operation: str, *values: object) -> bpy.types.NodeSocket:
        node = tree.nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                tree.links.new(value, socket)
        return node.outputs[0]

    def power(value: object, exponent: float) -> bpy.types.NodeSocket:
        return math("POWER", math("ABSOLUTE", value), exponent)

    def mix(factor: object, first: object, second: object) -> bpy.types.NodeSocket:
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        tree.links.new(factor, node.inputs[0])
        for socket, value in zip(node.inputs[6:8], (first, second), strict=True):
            if isinstance(value, tuple):
                socket.default_value = value
            else:
                tree.links.new(value, socket)
        return node.outputs[2]

    # A superellipse, on the back of the finger only.
    distance = math("ADD", power(across, 2.6), power(along, 2.6))
    inside = math("MULTIPLY_ADD", distance, -9.0, 9.0)
    inside.node.use_clamp = True
    nail = math("MULTIPLY", inside, math("GREATER_THAN", up, 0.15))
    edge = math("GREATER_THAN", along, 0.72)
    color = mix(nail, _SKIN_COLOR, mix(edge, _NAIL_COLOR, _EDGE_COLOR))
    tree.links.new(color, shader.inputs["Base Color"])
    roughness = math("MULTIPLY_ADD", nail, -0.25, 0.5)
    tree.links.new(roughness, shader.inputs["Roughness"])
    bump = tree.nodes.new("ShaderNodeBump")
    bump.inputs["Distance"].default_value = 0.0004
    tree.links.new(nail, bump.inputs["Height"])
    tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    return material
