# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface of clay from Blender's own nodes: points to volume to mesh, smoothed and colored."""

from __future__ import annotations

from typing import Any

import bpy

from ..base.surface_mesh import COLOR_ATTRIBUTE, SPACING_ATTRIBUTE, TEXTURE_ATTRIBUTE
from .look_material import MARK, VERSION, add_node

NODE_GROUP_NAME = "Clay Surface"
REST_ATTRIBUTE = "rest_position"

# Parameters of the node group, in units of the particle spacing; calibrated so that a block gets
# flat faces in the right place (see tests/clay_addon/clay/test_look.py).
_BALL_RADIUS = 1.3
_VOXEL_SIZE = 0.5
_THRESHOLD = 0.3
_OFFSET = -0.62
_CRUMB_OFFSET = -0.45
_CRUMB_VERTICES = (210.0, 630.0)
_SMOOTHING = 20
_NORMAL_SMOOTHING = 8
_COLOR_SMOOTHING = 2
_TEXTURE_SMOOTHING = 12
_VIEWPORT_LIMIT = 20_000


def surface_group() -> bpy.types.NodeTree:
    """The node group of the surface, created at the first call."""
    for tree in bpy.data.node_groups:
        if tree.get(MARK) == VERSION and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(NODE_GROUP_NAME, "GeometryNodeTree")
    tree[MARK] = VERSION
    tree.is_modifier = True
    socket = tree.interface.new_socket
    socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    for name, kind, default, lowest, description in (
        ("Surface", "Bool", True, None, "Show a surface; otherwise points"),
        ("Viewport Limit", "Int", _VIEWPORT_LIMIT, 0,
         "With more particles than this the viewport shows points, and only renders the surface"),
        ("Spacing", "Float", 0.005, 1e-9, "Distance between particles"),
        ("Smoothing", "Int", _SMOOTHING, 0, "Number of passes that smooth out the particles"),
    ):  # fmt: skip
        item = socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
        item.default_value = default
        item.description = description
        if lowest is not None:
            item.min_value = lowest
    tree.interface.items_tree["Spacing"].subtype = "DISTANCE"
    socket("Material", in_out="INPUT", socket_type="NodeSocketMaterial")

    link = tree.links.new
    given = add_node(tree, "NodeGroupInput", (-1600, 0))
    painted = add_node(tree, "GeometryNodeSetMaterial", (-1350, 300))
    link(given.outputs["Geometry"], painted.inputs["Geometry"])
    link(given.outputs["Material"], painted.inputs["Material"])
    points = painted.outputs[0]

    def lengths(factor: float, place: tuple[float, float]) -> Any:
        node = add_node(tree, "ShaderNodeMath", place)
        node.operation = "MULTIPLY"
        link(given.outputs["Spacing"], node.inputs[0])
        node.inputs[1].default_value = factor
        return node.outputs[0]

    volume = add_node(tree, "GeometryNodePointsToVolume", (-1100, 0), Density=1.0)
    if bpy.app.version < (5, 0, 0):
        volume.resolution_mode = "VOXEL_SIZE"
    else:
        volume.inputs["Resolution Mode"].default_value = "Size"
    link(points, volume.inputs["Points"])
    link(lengths(_VOXEL_SIZE, (-1350, -50)), volume.inputs["Voxel Size"])
    link(lengths(_BALL_RADIUS, (-1350, -200)), volume.inputs["Radius"])
    contour = add_node(
        tree, "GeometryNodeVolumeToMesh", (-900, 0), Threshold=_THRESHOLD, Adaptivity=0.0
    )
    link(volume.outputs[0], contour.inputs["Volume"])

    # Smoothing makes crumbs of a few particles vanish, so this weight exempts them: 0 on crumbs,
    # rising to 1 on islands of several hundred vertices.
    island = add_node(tree, "GeometryNodeInputMeshIsland", (-1500, -350))
    size = add_node(tree, "GeometryNodeAccumulateField", (-1300, -350))
    size.data_type = "INT"
    group = next(item for item in size.inputs if item.name in ("Group ID", "Group Index"))
    link(island.outputs["Island Index"], group)
    body = add_node(tree, "ShaderNodeMapRange", (-1100, -350))
    link(
        next(item for item in size.outputs if item.enabled and item.name == "Total"), body.inputs[0]
    )
    for number, value in enumerate((*_CRUMB_VERTICES, 0.0, 1.0), 1):
        body.inputs[number].default_value = value

    # The balls are larger than the particles so that no gaps show between them; this moves the
    # surface back inward.
    normal = add_node(tree, "GeometryNodeInputNormal", (-900, -200))
    # In a groove, unsmoothed normals would make the sides cross.
    even = add_node(tree, "GeometryNodeBlurAttribute", (-800, -100), Iterations=_NORMAL_SMOOTHING)
    even.data_type = "FLOAT_VECTOR"
    link(normal.outputs[0], next(item for item in even.inputs if item.enabled))
    outward = add_node(tree, "ShaderNodeVectorMath", (-750, -200))
    outward.operation = "NORMALIZE"
    link(even.outputs[0], outward.inputs[0])
    inward = add_node(tree, "ShaderNodeVectorMath", (-700, -200))
    inward.operation = "SCALE"
    link(outward.outputs[0], inward.inputs[0])
    depth = add_node(tree, "ShaderNodeMapRange", (-700, -350))
    link(body.outputs[0], depth.inputs[0])
    link(lengths(_CRUMB_OFFSET, (-900, -350)), depth.inputs[3])
    link(lengths(_OFFSET, (-900, -450)), depth.inputs[4])
    link(depth.outputs[0], inward.inputs["Scale"])
    placed = add_node(tree, "GeometryNodeSetPosition", (-500, 0))
    link(contour.outputs[0], placed.inputs["Geometry"])
    link(inward.outputs[0], placed.inputs["Offset"])

    # With B the blur, 2 B - B B flattens bumps like B but hardly shrinks crumbs and corners.
    position = add_node(tree, "GeometryNodeInputPosition", (-1100, -550))
    once, twice = (add_node(tree, "GeometryNodeBlurAttribute", (x, -550)) for x in (-900, -700))
    for blur in (once, twice):
        blur.data_type = "FLOAT_VECTOR"
        link(given.outputs["Smoothing"], blur.inputs["Iterations"])
        link(body.outputs[0], blur.inputs["Weight"])
    link(position.outputs[0], once.inputs[0])
    link(once.outputs[0], twice.inputs[0])
    double = add_node(tree, "ShaderNodeVectorMath", (-700, -700))
    double.operation = "SCALE"
    double.inputs["Scale"].default_value = 2.0
    link(once.outputs[0], double.inputs[0])
    kept = add_node(tree, "ShaderNodeVectorMath", (-500, -550))
    kept.operation = "SUBTRACT"
    link(double.outputs[0], kept.inputs[0])
    link(twice.outputs[0], kept.inputs[1])
    smoothed = add_node(tree, "GeometryNodeSetPosition", (-400, 0))
    link(placed.outputs[0], smoothed.inputs["Geometry"])
    link(kept.outputs[0], smoothed.inputs["Position"])

    nearest = add_node(tree, "GeometryNodeSampleNearest", (-500, -300))
    link(points, nearest.inputs[0])
    color = add_node(tree, "GeometryNodeInputNamedAttribute", (-500, -500), Name=COLOR_ATTRIBUTE)
    color.data_type = "FLOAT_COLOR"
    sample = add_node(tree, "GeometryNodeSampleIndex", (-300, -300))
    sample.data_type = "FLOAT_COLOR"
    link(points, sample.inputs["Geometry"])
    link(color.outputs["Attribute"], sample.inputs["Value"])
    link(nearest.outputs[0], sample.inputs["Index"])
    colored = add_node(tree, "GeometryNodeStoreNamedAttribute", (-300, 0), Name=COLOR_ATTRIBUTE)
    colored.data_type = "FLOAT_COLOR"
    colored.domain = "POINT"
    link(smoothed.outputs[0], colored.inputs["Geometry"])
    # Without blur, borders between colors would be jagged.
    mixed = add_node(tree, "GeometryNodeBlurAttribute", (-300, -700), Iterations=_COLOR_SMOOTHING)
    mixed.data_type = "FLOAT_COLOR"
    link(sample.outputs[0], next(item for item in mixed.inputs if item.enabled))
    link(mixed.outputs[0], colored.inputs["Value"])

    grain = _grain(tree, points, position.outputs[0], nearest.outputs[0])
    unit = add_node(tree, "ShaderNodeVectorMath", (-300, -550))
    unit.operation = "DIVIDE"
    link(grain, unit.inputs[0])
    link(given.outputs["Spacing"], unit.inputs[1])
    textured = add_node(tree, "GeometryNodeStoreNamedAttribute", (-100, 0), Name=TEXTURE_ATTRIBUTE)
    textured.data_type = "FLOAT_VECTOR"
    textured.domain = "POINT"
    link(colored.outputs[0], textured.inputs["Geometry"])
    link(unit.outputs[0], textured.inputs["Value"])
    sized = add_node(tree, "GeometryNodeStoreNamedAttribute", (0, 0), Name=SPACING_ATTRIBUTE)
    sized.data_type = "FLOAT"
    sized.domain = "POINT"
    link(textured.outputs[0], sized.inputs["Geometry"])
    link(given.outputs["Spacing"], sized.inputs["Value"])
    smooth = add_node(tree, "GeometryNodeSetShadeSmooth", (100, 0))
    link(sized.outputs[0], smooth.inputs[0])
    surface = add_node(tree, "GeometryNodeSetMaterial", (300, 0))
    link(smooth.outputs[0], surface.inputs["Geometry"])
    link(given.outputs["Material"], surface.inputs["Material"])

    count = add_node(tree, "GeometryNodeAttributeDomainSize", (-300, 550))
    count.component = "POINTCLOUD"
    link(points, count.inputs[0])
    many = add_node(tree, "FunctionNodeCompare", (-100, 550))
    many.data_type = "INT"
    many.operation = "GREATER_THAN"
    # In Blender 4.5, the sockets of the other data types exist too, but are disabled.
    first, second = (item for item in many.inputs if item.enabled)
    link(count.outputs["Point Count"], first)
    link(given.outputs["Viewport Limit"], second)
    viewport = add_node(tree, "GeometryNodeIsViewport", (-100, 350))
    heavy = add_node(tree, "FunctionNodeBooleanMath", (100, 450))
    heavy.operation = "AND"
    link(many.outputs[0], heavy.inputs[0])
    link(viewport.outputs[0], heavy.inputs[1])
    shown = add_node(tree, "FunctionNodeBooleanMath", (300, 450))
    shown.operation = "NIMPLY"
    link(given.outputs["Surface"], shown.inputs[0])
    link(heavy.outputs[0], shown.inputs[1])
    switch = add_node(tree, "GeometryNodeSwitch", (500, 100))
    switch.input_type = "GEOMETRY"
    link(shown.outputs[0], switch.inputs["Switch"])
    link(points, switch.inputs["False"])
    link(surface.outputs[0], switch.inputs["True"])
    result = add_node(tree, "NodeGroupOutput", (700, 100))
    link(switch.outputs[0], result.inputs["Geometry"])
    return tree


def _grain(tree: bpy.types.NodeTree, points: Any, position: Any, nearest: Any) -> Any:
    """Add nodes for the rest position of each vertex, so that the grain moves with the clay.

    If the points have no rest positions, the current position is used.
    """
    link = tree.links.new
    rest = add_node(tree, "GeometryNodeInputNamedAttribute", (-900, -900), Name=REST_ATTRIBUTE)
    rest.data_type = "FLOAT_VECTOR"
    first = add_node(tree, "GeometryNodeSampleIndex", (-700, -900))
    first.data_type = "FLOAT_VECTOR"
    link(points, first.inputs["Geometry"])
    link(rest.outputs["Attribute"], first.inputs["Value"])
    link(nearest, first.inputs["Index"])
    moved = add_node(tree, "ShaderNodeVectorMath", (-600, -900))
    moved.operation = "SUBTRACT"
    places = add_node(tree, "GeometryNodeSampleIndex", (-700, -1100))
    places.data_type = "FLOAT_VECTOR"
    link(points, places.inputs["Geometry"])
    link(position, places.inputs["Value"])
    link(nearest, places.inputs["Index"])
    link(first.outputs[0], moved.inputs[0])
    link(places.outputs[0], moved.inputs[1])
    even = add_node(tree, "GeometryNodeBlurAttribute", (-500, -900), Iterations=_TEXTURE_SMOOTHING)
    even.data_type = "FLOAT_VECTOR"
    link(moved.outputs[0], next(item for item in even.inputs if item.enabled))
    back = add_node(tree, "ShaderNodeVectorMath", (-400, -900))
    back.operation = "ADD"
    link(position, back.inputs[0])
    link(even.outputs[0], back.inputs[1])
    known = add_node(tree, "GeometryNodeSampleIndex", (-500, -1100))
    known.data_type = "BOOLEAN"
    link(points, known.inputs["Geometry"])
    link(rest.outputs["Exists"], known.inputs["Value"])
    grain = add_node(tree, "GeometryNodeSwitch", (-350, -900))
    grain.input_type = "VECTOR"
    link(known.outputs[0], grain.inputs["Switch"])
    link(position, grain.inputs["False"])
    link(back.outputs[0], grain.inputs["True"])
    return grain.outputs[0]
