# SPDX-License-Identifier: GPL-3.0-or-later
"""How clay looks: its material, and a surface in the viewport and in renders.

All of it is stock nodes, so it stays in the .blend and needs no add-on to show or render.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from .surface import Surface
from .surface_mesh import (
    COLOR_ATTRIBUTE,
    SPACING_ATTRIBUTE,
    TEXTURE_ATTRIBUTE,
    fill_surface_mesh,
)

MATERIAL_NAME = "Clay"
NODE_GROUP_NAME = "Clay Surface"
MODIFIER_NAME = "Clay Surface"
_MARK = "tactile_clay_look"
"""Custom property of what this module made, so that a user's own data of that name stays."""
_VERSION = 2

# The surface of the node group, in units of the particle distance; measured so that a block comes
# out with flat faces at the right place (see tests/clay_addon/test_look.py).
_BALL_RADIUS = 1.3
_VOXEL_SIZE = 0.5
_THRESHOLD = 0.3
_OFFSET = -0.62
_CRUMB_OFFSET = -0.45
_CRUMB_VERTICES = (210.0, 630.0)
_SMOOTHING = 20
_NORMAL_SMOOTHING = 8
_COLOR_SMOOTHING = 2
_VIEWPORT_LIMIT = 20_000


def clay_material() -> bpy.types.Material:
    """Return the material of all clay, made at the first call.

    Its colour is the attribute ``Color`` of the surface or the points.
    """
    for material in bpy.data.materials:
        if material.get(_MARK) == _VERSION and material.library is None:
            return material
    material = bpy.data.materials.new(MATERIAL_NAME)
    material[_MARK] = _VERSION
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    material.diffuse_color = (0.72, 0.36, 0.22, 1.0)
    tree = material.node_tree
    tree.nodes.clear()
    color = _add(tree, "ShaderNodeAttribute", (-800, 200))
    color.name = color.label = color.attribute_name = COLOR_ATTRIBUTE
    place = _add(tree, "ShaderNodeAttribute", (-1200, -200))
    place.name = place.label = place.attribute_name = TEXTURE_ATTRIBUTE
    spacing = _add(tree, "ShaderNodeAttribute", (-1000, -600))
    spacing.name = spacing.label = spacing.attribute_name = SPACING_ATTRIBUTE
    normal = None
    # Shallow dents as thumbs leave them, and the grain of the clay.
    for x, scale, detail, depth in ((-600, 0.22, 2.0, 0.6), (-350, 1.6, 5.0, 0.035)):
        noise = _add(tree, "ShaderNodeTexNoise", (x - 200, -150), Scale=scale, Detail=detail)
        tree.links.new(place.outputs["Vector"], noise.inputs["Vector"])
        height = _add(tree, "ShaderNodeMath", (x - 200, -500))
        height.operation = "MULTIPLY"
        tree.links.new(spacing.outputs["Fac"], height.inputs[0])
        height.inputs[1].default_value = depth
        bump = _add(tree, "ShaderNodeBump", (x, -150), Strength=1.0)
        tree.links.new(noise.outputs[0], bump.inputs["Height"])
        tree.links.new(height.outputs[0], bump.inputs["Distance"])
        if normal is not None:
            tree.links.new(normal, bump.inputs["Normal"])
        normal = bump.outputs["Normal"]
    shader = _add(
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
    output = _add(tree, "ShaderNodeOutputMaterial", (250, 200))
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def add_look(clay: bpy.types.Object, *, spacing: float | None = None) -> bpy.types.Modifier:
    """Show a clay object as a smooth, coloured surface.

    Adds the modifier "Clay Surface" last in the stack, or returns the one that is there, and puts
    the clay material on the object. The modifier's *Surface* switches between surface and points;
    above *Viewport Limit* particles the viewport shows points and only renders the surface.

    Args:
        clay: Point cloud object with the attributes ``radius`` and ``Color``.
        spacing: Distance between particles [Blender units]; twice the first radius where not
            given.

    Raises:
        ValueError: if the object is no point cloud or its spacing cannot be told.
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
        modifier.node_group = _surface_group()
    set_input(modifier, "Spacing", spacing)
    set_input(modifier, "Material", material)
    return modifier


def surface_object(
    surface: Surface, name: str, *, spacing: float | None = None
) -> bpy.types.Object:
    """Make a mesh object of a reconstructed surface, smooth shaded, with the clay material.

    The object is not linked to a collection.

    Args:
        surface: What `reconstruct` made.
        name: Name of the object.
        spacing: Distance between particles [Blender units], for the grain of the material; told
            from the mesh where not given.
    """
    mesh = bpy.data.meshes.new(name)
    if spacing is None:
        sides = surface.vertices[surface.faces[:, 0]] - surface.vertices[surface.faces[:, 1]]
        # The median edge of the reconstruction is 0.41 spacings.
        spacing = float(np.median(np.linalg.norm(sides, axis=1))) / 0.41
    fill_surface_mesh(mesh, surface.vertices, surface.faces, spacing=spacing, colors=surface.colors)
    mesh.materials.append(clay_material())
    return bpy.data.objects.new(name, mesh)


def set_input(modifier: bpy.types.Modifier, name: str, value: Any) -> None:
    """Set an input of a geometry nodes modifier by its name.

    Raises:
        KeyError: if the modifier has no such input.
    """
    identifier = _input_identifier(modifier, name)
    if bpy.app.version < (5, 2, 0):
        modifier[identifier] = value
    else:
        getattr(modifier.properties.inputs, identifier).value = value
    modifier.id_data.update_tag()


def get_input(modifier: bpy.types.Modifier, name: str) -> Any:
    """Return an input of a geometry nodes modifier by its name.

    Raises:
        KeyError: if the modifier has no such input.
    """
    identifier = _input_identifier(modifier, name)
    if bpy.app.version < (5, 2, 0):
        return modifier[identifier]
    return getattr(modifier.properties.inputs, identifier).value


def input_path(modifier: bpy.types.Modifier, name: str) -> str:
    """Return the data path, from its object, that keyframes of a modifier's input have.

    Raises:
        KeyError: if the modifier has no such input.
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


def _add(tree: bpy.types.NodeTree, kind: str, place: tuple[float, float], **values: Any) -> Any:
    """Add a node and set inputs by name."""
    node = tree.nodes.new(kind)
    node.location = place
    for name, value in values.items():
        node.inputs[name].default_value = value
    return node


def _surface_group() -> bpy.types.NodeTree:
    """Return the node group of the surface, made at the first call."""
    for tree in bpy.data.node_groups:
        if tree.get(_MARK) == _VERSION and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(NODE_GROUP_NAME, "GeometryNodeTree")
    tree[_MARK] = _VERSION
    tree.is_modifier = True
    socket = tree.interface.new_socket
    socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    for name, kind, default, lowest, description in (
        ("Surface", "Bool", True, None, "Show a surface; points otherwise"),
        ("Viewport Limit", "Int", _VIEWPORT_LIMIT, 0,
         "With more particles than this the viewport shows points, and only renders the surface"),
        ("Spacing", "Float", 0.005, 1e-9, "Distance between particles"),
        ("Smoothing", "Int", _SMOOTHING, 0, "Passes that flatten the trace of the particles"),
    ):  # fmt: skip
        item = socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
        item.default_value = default
        item.description = description
        if lowest is not None:
            item.min_value = lowest
    tree.interface.items_tree["Spacing"].subtype = "DISTANCE"
    socket("Material", in_out="INPUT", socket_type="NodeSocketMaterial")

    link = tree.links.new
    given = _add(tree, "NodeGroupInput", (-1600, 0))
    painted = _add(tree, "GeometryNodeSetMaterial", (-1350, 300))
    link(given.outputs["Geometry"], painted.inputs["Geometry"])
    link(given.outputs["Material"], painted.inputs["Material"])
    points = painted.outputs[0]

    def lengths(factor: float, place: tuple[float, float]) -> Any:
        node = _add(tree, "ShaderNodeMath", place)
        node.operation = "MULTIPLY"
        link(given.outputs["Spacing"], node.inputs[0])
        node.inputs[1].default_value = factor
        return node.outputs[0]

    volume = _add(tree, "GeometryNodePointsToVolume", (-1100, 0), Density=1.0)
    if bpy.app.version < (5, 0, 0):
        volume.resolution_mode = "VOXEL_SIZE"
    else:
        volume.inputs["Resolution Mode"].default_value = "Size"
    link(points, volume.inputs["Points"])
    link(lengths(_VOXEL_SIZE, (-1350, -50)), volume.inputs["Voxel Size"])
    link(lengths(_BALL_RADIUS, (-1350, -200)), volume.inputs["Radius"])
    contour = _add(
        tree, "GeometryNodeVolumeToMesh", (-900, 0), Threshold=_THRESHOLD, Adaptivity=0.0
    )
    link(volume.outputs[0], contour.inputs["Volume"])

    # Smoothing shrinks a crumb of a few particles to nothing, so it is spared: 0 there, 1 on all
    # that has some hundred vertices.
    island = _add(tree, "GeometryNodeInputMeshIsland", (-1500, -350))
    size = _add(tree, "GeometryNodeAccumulateField", (-1300, -350))
    size.data_type = "INT"
    group = next(item for item in size.inputs if item.name in ("Group ID", "Group Index"))
    link(island.outputs["Island Index"], group)
    body = _add(tree, "ShaderNodeMapRange", (-1100, -350))
    link(
        next(item for item in size.outputs if item.enabled and item.name == "Total"), body.inputs[0]
    )
    for number, value in enumerate((*_CRUMB_VERTICES, 0.0, 1.0), 1):
        body.inputs[number].default_value = value

    # The balls are larger than the particles so that no gap shows between them; this takes the
    # difference back.
    normal = _add(tree, "GeometryNodeInputNormal", (-900, -200))
    # Where particles left a groove, normals of their own would make the sides cross.
    even = _add(tree, "GeometryNodeBlurAttribute", (-800, -100), Iterations=_NORMAL_SMOOTHING)
    even.data_type = "FLOAT_VECTOR"
    link(normal.outputs[0], next(item for item in even.inputs if item.enabled))
    outward = _add(tree, "ShaderNodeVectorMath", (-750, -200))
    outward.operation = "NORMALIZE"
    link(even.outputs[0], outward.inputs[0])
    inward = _add(tree, "ShaderNodeVectorMath", (-700, -200))
    inward.operation = "SCALE"
    link(outward.outputs[0], inward.inputs[0])
    depth = _add(tree, "ShaderNodeMapRange", (-700, -350))
    link(body.outputs[0], depth.inputs[0])
    link(lengths(_CRUMB_OFFSET, (-900, -350)), depth.inputs[3])
    link(lengths(_OFFSET, (-900, -450)), depth.inputs[4])
    link(depth.outputs[0], inward.inputs["Scale"])
    placed = _add(tree, "GeometryNodeSetPosition", (-500, 0))
    link(contour.outputs[0], placed.inputs["Geometry"])
    link(inward.outputs[0], placed.inputs["Offset"])

    # With B the blur, 2 B - B B flattens bumps as B does but hardly shrinks crumbs and corners.
    position = _add(tree, "GeometryNodeInputPosition", (-1100, -550))
    once, twice = (_add(tree, "GeometryNodeBlurAttribute", (x, -550)) for x in (-900, -700))
    for blur in (once, twice):
        blur.data_type = "FLOAT_VECTOR"
        link(given.outputs["Smoothing"], blur.inputs["Iterations"])
        link(body.outputs[0], blur.inputs["Weight"])
    link(position.outputs[0], once.inputs[0])
    link(once.outputs[0], twice.inputs[0])
    double = _add(tree, "ShaderNodeVectorMath", (-700, -700))
    double.operation = "SCALE"
    double.inputs["Scale"].default_value = 2.0
    link(once.outputs[0], double.inputs[0])
    kept = _add(tree, "ShaderNodeVectorMath", (-500, -550))
    kept.operation = "SUBTRACT"
    link(double.outputs[0], kept.inputs[0])
    link(twice.outputs[0], kept.inputs[1])
    smoothed = _add(tree, "GeometryNodeSetPosition", (-400, 0))
    link(placed.outputs[0], smoothed.inputs["Geometry"])
    link(kept.outputs[0], smoothed.inputs["Position"])

    nearest = _add(tree, "GeometryNodeSampleNearest", (-500, -300))
    link(points, nearest.inputs[0])
    color = _add(tree, "GeometryNodeInputNamedAttribute", (-500, -500), Name=COLOR_ATTRIBUTE)
    color.data_type = "FLOAT_COLOR"
    sample = _add(tree, "GeometryNodeSampleIndex", (-300, -300))
    sample.data_type = "FLOAT_COLOR"
    link(points, sample.inputs["Geometry"])
    link(color.outputs["Attribute"], sample.inputs["Value"])
    link(nearest.outputs[0], sample.inputs["Index"])
    colored = _add(tree, "GeometryNodeStoreNamedAttribute", (-300, 0), Name=COLOR_ATTRIBUTE)
    colored.data_type = "FLOAT_COLOR"
    colored.domain = "POINT"
    link(smoothed.outputs[0], colored.inputs["Geometry"])
    # The nearest particle's colour alone would leave borders jagged.
    mixed = _add(tree, "GeometryNodeBlurAttribute", (-300, -700), Iterations=_COLOR_SMOOTHING)
    mixed.data_type = "FLOAT_COLOR"
    link(sample.outputs[0], next(item for item in mixed.inputs if item.enabled))
    link(mixed.outputs[0], colored.inputs["Value"])

    unit = _add(tree, "ShaderNodeVectorMath", (-300, -550))
    unit.operation = "DIVIDE"
    link(position.outputs[0], unit.inputs[0])
    link(given.outputs["Spacing"], unit.inputs[1])
    textured = _add(tree, "GeometryNodeStoreNamedAttribute", (-100, 0), Name=TEXTURE_ATTRIBUTE)
    textured.data_type = "FLOAT_VECTOR"
    textured.domain = "POINT"
    link(colored.outputs[0], textured.inputs["Geometry"])
    link(unit.outputs[0], textured.inputs["Value"])
    sized = _add(tree, "GeometryNodeStoreNamedAttribute", (0, 0), Name=SPACING_ATTRIBUTE)
    sized.data_type = "FLOAT"
    sized.domain = "POINT"
    link(textured.outputs[0], sized.inputs["Geometry"])
    link(given.outputs["Spacing"], sized.inputs["Value"])
    smooth = _add(tree, "GeometryNodeSetShadeSmooth", (100, 0))
    link(sized.outputs[0], smooth.inputs[0])
    surface = _add(tree, "GeometryNodeSetMaterial", (300, 0))
    link(smooth.outputs[0], surface.inputs["Geometry"])
    link(given.outputs["Material"], surface.inputs["Material"])

    count = _add(tree, "GeometryNodeAttributeDomainSize", (-300, 550))
    count.component = "POINTCLOUD"
    link(points, count.inputs[0])
    many = _add(tree, "FunctionNodeCompare", (-100, 550))
    many.data_type = "INT"
    many.operation = "GREATER_THAN"
    # Blender 4.5 keeps the sockets of the other data types beside these.
    first, second = (item for item in many.inputs if item.enabled)
    link(count.outputs["Point Count"], first)
    link(given.outputs["Viewport Limit"], second)
    viewport = _add(tree, "GeometryNodeIsViewport", (-100, 350))
    heavy = _add(tree, "FunctionNodeBooleanMath", (100, 450))
    heavy.operation = "AND"
    link(many.outputs[0], heavy.inputs[0])
    link(viewport.outputs[0], heavy.inputs[1])
    shown = _add(tree, "FunctionNodeBooleanMath", (300, 450))
    shown.operation = "NIMPLY"
    link(given.outputs["Surface"], shown.inputs[0])
    link(heavy.outputs[0], shown.inputs[1])
    switch = _add(tree, "GeometryNodeSwitch", (500, 100))
    switch.input_type = "GEOMETRY"
    link(shown.outputs[0], switch.inputs["Switch"])
    link(points, switch.inputs["False"])
    link(surface.outputs[0], switch.inputs["True"])
    result = _add(tree, "NodeGroupOutput", (700, 100))
    link(switch.outputs[0], result.inputs["Geometry"])
    return tree
