# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry nodes of a delivery: to export a shape, and to shade the played surface."""

from __future__ import annotations

import bpy

from ..base.surface_mesh import COLOR_ATTRIBUTE, SPACING_ATTRIBUTE, TEXTURE_ATTRIBUTE

FILE_COLOR = "displayColor"
"""Color attribute that USD viewers show by default."""
_MARK = "tactile_clay_delivery"
_VERSION = 1


def delayed_group(domain: str) -> bpy.types.NodeTree:
    """Nodes that show one element of a mesh before a frame, and all of it from this frame on."""
    tree = bpy.data.node_groups.new("Clay Delivery", "GeometryNodeTree")
    tree.is_modifier = True
    socket = tree.interface.new_socket
    socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    socket("Frame", in_out="INPUT", socket_type="NodeSocketInt")
    socket("Radius", in_out="INPUT", socket_type="NodeSocketFloat")
    socket("Particles", in_out="INPUT", socket_type="NodeSocketObject")
    inputs = tree.nodes.new("NodeGroupInput")
    early = tree.nodes.new("ShaderNodeMath")
    early.operation = "LESS_THAN"
    tree.links.new(tree.nodes.new("GeometryNodeInputSceneTime").outputs["Frame"], early.inputs[0])
    tree.links.new(inputs.outputs["Frame"], early.inputs[1])
    # The index of an element before the frame, so that all but the first are deleted; else 0.
    deleted = tree.nodes.new("ShaderNodeMath")
    deleted.operation = "MULTIPLY"
    tree.links.new(early.outputs[0], deleted.inputs[0])
    tree.links.new(tree.nodes.new("GeometryNodeInputIndex").outputs[0], deleted.inputs[1])
    delete = tree.nodes.new("GeometryNodeDeleteGeometry")
    delete.domain = domain
    source = inputs
    if domain == "POINT":
        source = tree.nodes.new("GeometryNodeObjectInfo")
        tree.links.new(inputs.outputs["Particles"], source.inputs["Object"])
    tree.links.new(source.outputs["Geometry"], delete.inputs["Geometry"])
    tree.links.new(deleted.outputs[0], delete.inputs["Selection"])
    geometry = delete.outputs[0]
    if domain == "POINT":
        points = tree.nodes.new("GeometryNodeMeshToPoints")
        tree.links.new(geometry, points.inputs["Mesh"])
        tree.links.new(inputs.outputs["Radius"], points.inputs["Radius"])
        geometry = points.outputs[0]
    result = tree.nodes.new("NodeGroupOutput")
    tree.links.new(geometry, result.inputs["Geometry"])
    return tree


def finish_group() -> bpy.types.NodeTree:
    """Nodes that set the color, grain and material of a delivered surface."""
    for tree in bpy.data.node_groups:
        if tree.get(_MARK) == _VERSION and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new("Clay Delivery", "GeometryNodeTree")
    tree[_MARK] = _VERSION
    tree.is_modifier = True
    socket = tree.interface.new_socket
    socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    spacing = socket("Spacing", in_out="INPUT", socket_type="NodeSocketFloat")
    spacing.default_value, spacing.min_value = 0.005, 1e-9
    spacing.description = "Particle spacing, for the grain of the material"
    spacing.subtype = "DISTANCE"
    socket("Material", in_out="INPUT", socket_type="NodeSocketMaterial")
    link = tree.links.new
    inputs = tree.nodes.new("NodeGroupInput")
    inputs.location = (-700, 0)

    def store(name: str, kind: str, value: bpy.types.NodeSocket, x: float) -> bpy.types.Node:
        node = tree.nodes.new("GeometryNodeStoreNamedAttribute")
        node.location = (x, 0)
        node.data_type = kind
        node.domain = "POINT"
        node.inputs["Name"].default_value = name
        link(value, node.inputs["Value"])
        return node

    color = tree.nodes.new("GeometryNodeInputNamedAttribute")
    color.location = (-500, -250)
    color.data_type = "FLOAT_COLOR"
    color.inputs["Name"].default_value = FILE_COLOR
    texture = tree.nodes.new("ShaderNodeVectorMath")
    texture.location = (-300, -250)
    texture.operation = "DIVIDE"
    link(tree.nodes.new("GeometryNodeInputPosition").outputs[0], texture.inputs[0])
    link(inputs.outputs["Spacing"], texture.inputs[1])
    geometry = inputs.outputs["Geometry"]
    for name, kind, value, x in (
        (COLOR_ATTRIBUTE, "FLOAT_COLOR", color.outputs["Attribute"], -300),
        (TEXTURE_ATTRIBUTE, "FLOAT_VECTOR", texture.outputs[0], -100),
        (SPACING_ATTRIBUTE, "FLOAT", inputs.outputs["Spacing"], 100),
    ):
        node = store(name, kind, value, x)
        link(geometry, node.inputs["Geometry"])
        geometry = node.outputs[0]
    smooth = tree.nodes.new("GeometryNodeSetShadeSmooth")
    smooth.location = (300, 0)
    link(geometry, smooth.inputs[0])
    material = tree.nodes.new("GeometryNodeSetMaterial")
    material.location = (500, 0)
    link(smooth.outputs[0], material.inputs["Geometry"])
    link(inputs.outputs["Material"], material.inputs["Material"])
    result = tree.nodes.new("NodeGroupOutput")
    result.location = (700, 0)
    link(material.outputs[0], result.inputs["Geometry"])
    return tree
