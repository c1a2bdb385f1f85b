# SPDX-License-Identifier: GPL-3.0-or-later
"""Stop motion: sculpted shapes as keyframes on the timeline.

Each keyed shape, or pose, is a separate point cloud with its own particles and colors, so the
number of particles may differ between keys. A geometry nodes modifier on the clay selects a pose
by its input *Pose*; 0 is the clay itself, simulated or sculpted. That input has ordinary keyframes
with constant interpolation, which can be moved, copied and deleted in the Dope Sheet. Only
Blender's own nodes are used, so it plays and renders without the add-on.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.core.errors import TactileClayError
from ..base.keyed_channels import find_curve
from ..clay.look import get_input, input_path, set_input
from ..model.clay_points import BAKED_MARK, SCULPTED_MARK
from .packed import FRAME_ATTRIBUTE, is_packed
from .packed import MODIFIER_NAME as PLAYBACK_MODIFIER

NODE_GROUP_NAME = "Clay Poses"
MODIFIER_NAME = "Clay Poses"
_INPUT = "Pose"
_SWITCH = "Pose Switch"
_MARK = "tactile_clay_poses"
_VERSION = 1
_SAME_TIME = 0.01
"""Blender takes keys that are nearer to each other for one."""


class PoseError(TactileClayError, ValueError):
    """A pose cannot be keyed or applied; the message says why and what to do."""


def has_poses(clay: bpy.types.Object) -> bool:
    """Whether an object has keyed shapes."""
    return pose_modifier(clay) is not None


def pose_modifier(clay: bpy.types.Object) -> bpy.types.Modifier | None:
    """The modifier that shows an object's keyed shapes; None if it has none."""
    for modifier in clay.modifiers:
        group = modifier.node_group if modifier.type == "NODES" else None
        if group is not None and group.get(_MARK) == _VERSION:
            return modifier
    return None


def pose_at(clay: bpy.types.Object, time: float) -> bpy.types.Object | None:
    """The keyed shape that an object shows at a time; None where it shows itself.

    Args:
        clay: Point cloud object.
        time: Animation time; see `animation_time`.
    """
    modifier = pose_modifier(clay)
    if modifier is None:
        return None
    curve = find_curve(clay, input_path(modifier, _INPUT))
    value = get_input(modifier, _INPUT) if curve is None else curve.evaluate(time)
    return _poses(modifier).get(round(value))


def needs_no_cache(clay: bpy.types.Object, time: float) -> bool:
    """Whether what an object shows at a time is in the .blend: packed, or keyed as a pose."""
    return is_packed(clay) or pose_at(clay, time) is not None


def pose_times(clay: bpy.types.Object) -> list[float]:
    """Animation times at which an object has a key of its shape, sorted."""
    modifier = pose_modifier(clay)
    curve = find_curve(clay, input_path(modifier, _INPUT)) if modifier else None
    return sorted({key.co.x for key in curve.keyframe_points}) if curve else []


def key_pose(
    clay: bpy.types.Object, positions: NDArray[np.float32], *, time: float
) -> bpy.types.Object:
    """Keep a shape of a clay object as a key at a time, held until the next one.

    A key at that time is replaced.

    Args:
        clay: Point cloud object.
        positions: The shape, in the object's coordinates [Blender units], shape [N, 3].
        time: Animation time; see `animation_time`.

    Returns:
        The point cloud object that holds the shape. It is in no collection.

    Raises:
        PoseError: The object is not a point cloud or is linked from another file, or the shape is
            not finite or has a different number of points.
    """
    _check(clay, positions)
    data = clay.data.copy()
    data.name = f"{clay.name} pose"
    for name in [item.name for item in data.attributes if item.name.startswith(FRAME_ATTRIBUTE)]:
        data.attributes.remove(data.attributes[name])
    for mark in (BAKED_MARK, SCULPTED_MARK):
        data.pop(mark, None)
    values = np.ascontiguousarray(positions, np.float32).ravel()
    for name in ("position", "rest_position"):
        layer = data.attributes.get(name) or data.attributes.new(name, "FLOAT_VECTOR", "POINT")
        layer.data.foreach_set("vector", values)
    pose = bpy.data.objects.new(f"{clay.name} pose", data)
    modifier = _own_modifier(clay) or _add_modifier(clay)
    set_input(modifier, _INPUT, _add_pose(modifier.node_group, pose))
    _insert_key(clay, modifier, time)
    _drop_unused(clay)
    return pose


def key_clay(clay: bpy.types.Object, *, time: float) -> None:
    """Let an object show itself, simulated or sculpted, from a time on.

    Args:
        clay: An object for which `has_poses` holds.
        time: Animation time; see `animation_time`.
    """
    modifier = _own_modifier(clay)
    if modifier is None:
        return
    set_input(modifier, _INPUT, 0)
    _insert_key(clay, modifier, time)
    _drop_unused(clay)


def remove_key(clay: bpy.types.Object, *, time: float) -> bool:
    """Take the key at a time away, and its shape where no other key shows it.

    Returns:
        Whether there was one.
    """
    modifier = _own_modifier(clay)
    if modifier is None or not any(abs(key - time) < _SAME_TIME for key in pose_times(clay)):
        return False
    clay.keyframe_delete(input_path(modifier, _INPUT), frame=time)
    if not pose_times(clay):
        remove_poses(clay)
    else:
        _drop_unused(clay)
    return True


def remove_poses(clay: bpy.types.Object) -> None:
    """Remove all keyed shapes from an object, which then shows its own points again."""
    modifier = pose_modifier(clay)
    if modifier is None:
        return
    group = modifier.node_group
    poses = list(_poses(modifier).values())
    path = input_path(modifier, _INPUT)
    curve = find_curve(clay, path)
    if curve is not None:
        for time in [key.co.x for key in curve.keyframe_points]:
            clay.keyframe_delete(path, frame=time)
    clay.modifiers.remove(modifier)
    if group.users == 0:
        bpy.data.node_groups.remove(group)
        for pose in poses:
            _delete(pose)


def apply_pose(clay: bpy.types.Object, *, time: float) -> bool:
    """Make the shape keyed at a time the clay itself, to go on sculpting from it.

    Returns:
        Whether the object showed a keyed shape at that frame; if not, nothing has changed.

    Raises:
        PoseError: The object plays packed frames, which are attributes of its own points.
    """
    pose = pose_at(clay, time)
    if pose is None:
        return False
    if is_packed(clay):
        raise PoseError(f"{clay.name!r} plays packed frames. Press Unpack Playback first.")
    before = clay.data
    name = before.name
    clay.data = pose.data.copy()
    if before.users == 0:
        bpy.data.pointclouds.remove(before)
    clay.data.name = name
    return True


# Implementation ---------------------------------------------------------------------------------


def _check(clay: bpy.types.Object, positions: NDArray[np.float32]) -> None:
    if clay.type != "POINTCLOUD":
        raise PoseError(f"{clay.name!r} is a {clay.type.lower()}, not a point cloud of clay.")
    if clay.library is not None or clay.data.library is not None:
        raise PoseError(
            f"{clay.name!r} is linked from another file, so keys set here would be lost. Make it "
            "local first (Object > Relations > Make Local)."
        )
    if positions.shape != (len(clay.data.points), 3):
        raise PoseError(
            f"The positions of {clay.name!r} have shape {positions.shape}, but it needs "
            f"{(len(clay.data.points), 3)}."
        )
    bad = int((~np.isfinite(positions).all(1)).sum())
    if bad:
        raise PoseError(
            f"{bad} particles of {clay.name!r} have positions that are not finite. Go back to a "
            "frame where they were."
        )


def _own_modifier(clay: bpy.types.Object) -> bpy.types.Modifier | None:
    """The modifier, with a node group that is not shared with duplicates of the object."""
    modifier = pose_modifier(clay)
    if modifier is not None and modifier.node_group.users > 1:
        modifier.node_group = modifier.node_group.copy()
    return modifier


def _poses(modifier: bpy.types.Modifier) -> dict[int, bpy.types.Object]:
    """The shapes by number."""
    found = {}
    switch = modifier.node_group.nodes[_SWITCH]
    for link in modifier.node_group.links:
        if link.to_node == switch and link.from_node.type == "OBJECT_INFO":
            pose = link.from_node.inputs[0].default_value
            if pose is not None and pose.type == "POINTCLOUD":
                found[_number(switch, link.to_socket)] = pose
    return found


def _number(switch: bpy.types.Node, socket: bpy.types.NodeSocket) -> int:
    # The first input is the index.
    return next(i for i, each in enumerate(switch.inputs) if each == socket) - 1


def _add_pose(group: bpy.types.NodeTree, pose: bpy.types.Object) -> int:
    """Link a shape to the first free input of the switch, and return its number."""
    switch = group.nodes[_SWITCH]
    # The last socket is only for adding new ones.
    free = [s for s in list(switch.inputs)[2:-1] if not s.is_linked]
    if not free:
        switch.index_switch_items.new()
        free = [list(switch.inputs)[-2]]
    number = _number(switch, free[0])
    source = group.nodes.new("GeometryNodeObjectInfo")
    source.location = (-300, -200 * number)
    source.inputs[0].default_value = pose
    group.links.new(source.outputs["Geometry"], switch.inputs[number + 1])
    return number


def _drop_unused(clay: bpy.types.Object) -> None:
    """Delete the shapes that no key uses any more."""
    modifier = pose_modifier(clay)
    curve = find_curve(clay, input_path(modifier, _INPUT)) if modifier else None
    if modifier is None or curve is None:
        return
    used = {round(key.co.y) for key in curve.keyframe_points}
    group = modifier.node_group
    for number, pose in _poses(modifier).items():
        if number not in used:
            socket = group.nodes[_SWITCH].inputs[number + 1]
            group.nodes.remove(socket.links[0].from_node)
            _delete(pose)


def _delete(pose: bpy.types.Object) -> None:
    if pose.users == 0:
        data = pose.data
        bpy.data.objects.remove(pose)
        if data.users == 0:
            bpy.data.pointclouds.remove(data)


def _insert_key(clay: bpy.types.Object, modifier: bpy.types.Modifier, time: float) -> None:
    path = input_path(modifier, _INPUT)
    clay.keyframe_insert(path, frame=time)
    curve = find_curve(clay, path)
    assert curve is not None
    for key in curve.keyframe_points:
        key.interpolation = "CONSTANT"
    curve.update()


def _add_modifier(clay: bpy.types.Object) -> bpy.types.Modifier:
    """Add the modifier, before those that turn the points into a surface."""
    modifier = clay.modifiers.new(MODIFIER_NAME, "NODES")
    modifier.node_group = _pose_group()
    names = [item.name for item in clay.modifiers]
    place = names.index(PLAYBACK_MODIFIER) + 1 if PLAYBACK_MODIFIER in names else 0
    clay.modifiers.move(len(clay.modifiers) - 1, place)
    return modifier


def _pose_group() -> bpy.types.NodeTree:
    """A new node group without shapes; each object needs its own."""
    tree = bpy.data.node_groups.new(NODE_GROUP_NAME, "GeometryNodeTree")
    tree[_MARK] = _VERSION
    tree.is_modifier = True
    socket = tree.interface.new_socket
    socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    pose = socket(_INPUT, in_out="INPUT", socket_type="NodeSocketInt")
    pose.min_value = 0
    pose.description = "Number of the displayed pose; 0 is the clay itself"
    given = tree.nodes.new("NodeGroupInput")
    given.location = (-300, 100)
    switch = tree.nodes.new("GeometryNodeIndexSwitch")
    switch.name = switch.label = _SWITCH
    switch.data_type = "GEOMETRY"
    tree.links.new(given.outputs[_INPUT], switch.inputs[0])
    tree.links.new(given.outputs["Geometry"], switch.inputs[1])
    result = tree.nodes.new("NodeGroupOutput")
    result.location = (250, 0)
    tree.links.new(switch.outputs[0], result.inputs["Geometry"])
    return tree
