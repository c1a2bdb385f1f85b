# SPDX-License-Identifier: GPL-3.0-or-later
"""The object that plays a delivery: a Mesh Sequence Cache and stock nodes, none of the add-on."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np

from .delivery_files import COLOR_ATTRIBUTE as FILE_COLOR
from .delivery_files import FRAMES_FOLDER, POINTS_PATH, ROOT_NAME
from .keyed_channels import CONSTANT, Channel, write_channels
from .look import set_input
from .look_material import clay_material
from .shown_clay import world_spacing
from .surface_mesh import COLOR_ATTRIBUTE, SPACING_ATTRIBUTE, TEXTURE_ATTRIBUTE

OBJECT_NAME = "Clay Delivery"
POINTS_NAME = "Clay Delivery Points"
MODIFIER_NAME = "Clay Delivery"
NODE_GROUP_NAME = "Clay Delivery"
_MARK = "tactile_clay_delivery"
_POINTS_MARK = "tactile_clay_delivery_points"
_HIDDEN_MARK = "tactile_clay_delivered"
"""Custom property of clay that a delivery hid: whether it was to be rendered before."""
_VERSION = 1


def delivered_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The object of a scene that plays a delivery; None where there is none."""
    return next((item for item in scene.objects if item.get(_MARK)), None)


def close_delivery(scene: bpy.types.Scene) -> None:
    """Let go of the files of a delivery; the object that played it stays, and shows nothing."""
    for item in (delivered_object(scene), _points_object(scene)):
        for modifier in item.modifiers if item else ():
            if modifier.type == "MESH_SEQUENCE_CACHE" and modifier.cache_file is not None:
                used = modifier.cache_file
                modifier.cache_file = None
                if used.users == 0:
                    bpy.data.batch_remove([used])


def show_delivery(
    scene: bpy.types.Scene,
    clay: Sequence[bpy.types.Object],
    folder: Path,
    kind: str,
    shapes: Mapping[int, str],
    object_path: str,
    *,
    points: bool = False,
) -> bpy.types.Object:
    """Play a delivery in place of the clay, which is hidden.

    An object that played an earlier delivery plays this one, with the material and the modifiers
    that it was given since.

    Args:
        scene: Where the clay is.
        clay: What was delivered.
        folder: Where the files are.
        kind: ``usd`` or ``abc``.
        shapes: Name of the file shown at each frame.
        object_path: Where in a file the surface is.
        points: Whether the files have the particles too: an object that plays them is made, hidden.

    Returns:
        The object that plays the surface.
    """
    close_delivery(scene)
    item = delivered_object(scene) or _new_object(scene, clay)
    item[_MARK] = kind
    first = f"{FRAMES_FOLDER}/{shapes[min(shapes)]}"
    cache_file = _open(folder / (ROOT_NAME if kind == "usd" else first))
    if kind == "abc":
        _play_sequence(cache_file, shapes)
    _play(item, cache_file, object_path)
    cloud = _points_object(scene)
    if points:
        _play(cloud or _new_points(scene), cache_file, POINTS_PATH)
    elif cloud is not None:
        _remove(cloud)
    for part in clay:
        if _HIDDEN_MARK not in part:
            part[_HIDDEN_MARK] = not part.hide_render
        part.hide_render = True
        # Not in the view layer where its collection is excluded.
        with contextlib.suppress(RuntimeError):
            part.hide_set(True)
    return item


def remove_delivery(scene: bpy.types.Scene) -> bool:
    """Show the clay again, not what was delivered. The files stay on the disk.

    Returns:
        Whether a delivery was shown.
    """
    item = delivered_object(scene)
    close_delivery(scene)
    for made in (item, _points_object(scene)):
        if made is not None:
            _remove(made)
    for part in scene.objects:
        if _HIDDEN_MARK in part:
            part.hide_render = not part[_HIDDEN_MARK]
            del part[_HIDDEN_MARK]
            with contextlib.suppress(RuntimeError):
                part.hide_set(False)
    return item is not None


def _points_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    return next((item for item in scene.objects if item.get(_POINTS_MARK)), None)


def _new_points(scene: bpy.types.Scene) -> bpy.types.Object:
    item = bpy.data.objects.new(POINTS_NAME, bpy.data.pointclouds.new(POINTS_NAME))
    item[_POINTS_MARK] = True
    scene.collection.objects.link(item)
    item.modifiers.new("Mesh Sequence Cache", "MESH_SEQUENCE_CACHE")
    # They lie inside the surface.
    item.hide_render = True
    with contextlib.suppress(RuntimeError):
        item.hide_set(True)
    return item


def _play(item: bpy.types.Object, cache_file: bpy.types.CacheFile, path: str) -> None:
    player = next((m for m in item.modifiers if m.type == "MESH_SEQUENCE_CACHE"), None)
    if player is None:
        player = item.modifiers.new("Mesh Sequence Cache", "MESH_SEQUENCE_CACHE")
        item.modifiers.move(len(item.modifiers) - 1, 0)
    player.cache_file = cache_file
    player.object_path = path


def _remove(item: bpy.types.Object) -> None:
    data = item.data
    bpy.data.objects.remove(item)
    if data.users == 0:
        bpy.data.batch_remove([data])


def _new_object(scene: bpy.types.Scene, clay: Sequence[bpy.types.Object]) -> bpy.types.Object:
    item = bpy.data.objects.new(OBJECT_NAME, bpy.data.meshes.new(OBJECT_NAME))
    scene.collection.objects.link(item)
    item.modifiers.new("Mesh Sequence Cache", "MESH_SEQUENCE_CACHE")
    modifier = item.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = _finish_group()
    material = clay[0].active_material or clay_material()
    item.data.materials.append(material)
    set_input(modifier, "Material", material)
    set_input(modifier, "Spacing", world_spacing(clay[0]))
    return item


def _open(path: Path) -> bpy.types.CacheFile:
    before = set(bpy.data.cache_files)
    bpy.ops.cachefile.open(filepath=str(path))
    (cache_file,) = set(bpy.data.cache_files) - before
    # The operator counts itself as a user, so that the file would never be let go of.
    cache_file.user_clear()
    if bpy.data.filepath:
        with contextlib.suppress(ValueError):
            cache_file.filepath = bpy.path.relpath(str(path))
    return cache_file


def _play_sequence(cache_file: bpy.types.CacheFile, shapes: Mapping[int, str]) -> None:
    """Let a file of each shape be opened at the frames at which it is shown."""
    cache_file.is_sequence = True
    cache_file.override_frame = True
    numbers = [int(shapes[frame].rpartition("_")[2].partition(".")[0]) for frame in shapes]
    channel = Channel("frame", 0, np.array(list(shapes)), np.array(numbers), CONSTANT)
    write_channels(cache_file, cache_file.name, [channel])


def _finish_group() -> bpy.types.NodeTree:
    """Return the nodes that give a delivered surface its colour, grain and material."""
    for tree in bpy.data.node_groups:
        if tree.get(_MARK) == _VERSION and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(NODE_GROUP_NAME, "GeometryNodeTree")
    tree[_MARK] = _VERSION
    tree.is_modifier = True
    socket = tree.interface.new_socket
    socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    spacing = socket("Spacing", in_out="INPUT", socket_type="NodeSocketFloat")
    spacing.default_value, spacing.min_value = 0.005, 1e-9
    spacing.description = "Distance between the particles, for the grain of the material"
    spacing.subtype = "DISTANCE"
    socket("Material", in_out="INPUT", socket_type="NodeSocketMaterial")
    link = tree.links.new
    given = tree.nodes.new("NodeGroupInput")
    given.location = (-700, 0)

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
    unit = tree.nodes.new("ShaderNodeVectorMath")
    unit.location = (-300, -250)
    unit.operation = "DIVIDE"
    link(tree.nodes.new("GeometryNodeInputPosition").outputs[0], unit.inputs[0])
    link(given.outputs["Spacing"], unit.inputs[1])
    geometry = given.outputs["Geometry"]
    for name, kind, value, x in (
        (COLOR_ATTRIBUTE, "FLOAT_COLOR", color.outputs["Attribute"], -300),
        (TEXTURE_ATTRIBUTE, "FLOAT_VECTOR", unit.outputs[0], -100),
        (SPACING_ATTRIBUTE, "FLOAT", given.outputs["Spacing"], 100),
    ):
        node = store(name, kind, value, x)
        link(geometry, node.inputs["Geometry"])
        geometry = node.outputs[0]
    smooth = tree.nodes.new("GeometryNodeSetShadeSmooth")
    smooth.location = (300, 0)
    link(geometry, smooth.inputs[0])
    painted = tree.nodes.new("GeometryNodeSetMaterial")
    painted.location = (500, 0)
    link(smooth.outputs[0], painted.inputs["Geometry"])
    link(given.outputs["Material"], painted.inputs["Material"])
    result = tree.nodes.new("NodeGroupOutput")
    result.location = (700, 0)
    link(painted.outputs[0], result.inputs["Geometry"])
    return tree
