# SPDX-License-Identifier: GPL-3.0-or-later
"""Keyframes of a take, which reproduce the motion of hands, colliders and tools on the timeline.

There is a key at the end of each solver step, even between whole frames, because that is the motion
that acted on the clay. Objects get keys if they moved, or if they have an action, which might move
them now.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ...solver.geometry.rotations import quaternions_from_matrices
from ..base.keyed_channels import CONSTANT, Channel, significant_keys, write_channels
from ..base.units import from_meters
from ..core.take.data import Layout, Steps, Take, ToolShape, frame_count
from ..model.collider import TAKE_TOOL
from ..tracking.armature import CONTACT_PROPERTY

TOOL_COLLECTION = "Take Tools"
_NUMERIC_NOISE = 1e-6


class KeyedTake(NamedTuple):
    """Result of `key_take`."""

    first: int
    """First frame."""
    last: int
    """Last frame."""
    objects: tuple[str, ...]
    """Names of the objects with a new action."""
    missing: tuple[str, ...]
    """Names of recorded objects that are no longer in the file."""


class _Track(NamedTuple):
    """Values of one quantity during a take."""

    times: NDArray[np.float64]
    """Times [s], shape [K]."""
    values: NDArray[Any]
    """Values, shape [K, ...]."""


def key_take(scene: bpy.types.Scene, take: Take, *, name: str = "Take") -> KeyedTake:
    """Put the motion of a take on the timeline.

    Each object that moved gets a new action; its previous one stays in the file. Tools moved with
    the mouse become colliders in a separate collection, replacing those of an earlier take.

    Args:
        scene: Scene of the take.
        take: The take.
        name: Prefix for the names of the actions.
    """
    rate, first = take.header.frames_per_second, take.header.frame_start
    last = first + frame_count(take.seconds, rate)
    keyed, missing = [], []
    objects = _tracks(take.steps, "objects", lambda layout: layout.objects)
    enabled = _tracks(take.steps, "enabled", lambda layout: layout.colliders)
    contacts = _tracks(take.steps, "contacts", lambda layout: [a for a, _ in layout.armatures])
    bones = _tracks(
        take.steps, "bones", lambda layout: [(a, b) for a, names in layout.armatures for b in names]
    )
    for object_name in dict.fromkeys((*objects, *enabled)):
        item = bpy.data.objects.get(object_name)
        if item is None:
            missing.append(object_name)
            continue
        animated = item.animation_data is not None and item.animation_data.action is not None
        builder = _ChannelBuilder(first, rate, always=animated)
        channels = list(builder.transform(objects.get(object_name), item))
        if object_name in enabled:
            track = _Track(enabled[object_name].times, enabled[object_name].values)
            path = "tactile_clay.collider_enabled"
            channels += builder.number(path, track, CONSTANT)
        if item.type == "ARMATURE":
            for bone in item.pose.bones:
                channels += builder.transform(bones.get((object_name, bone.name)), bone)
            if channels or CONTACT_PROPERTY in item:
                path = f'["{CONTACT_PROPERTY}"]'
                channels += builder.number(path, contacts[object_name], CONSTANT)
        if channels:
            write_channels(item, f"{name} {object_name}", channels)
            keyed.append(object_name)
    tools = _key_tools(scene, take, _ChannelBuilder(first, rate, always=True), name)
    return KeyedTake(first, last, (*keyed, *tools), tuple(missing))


class _ChannelBuilder:
    """Converts tracks to animation channels.

    Args:
        start: Frame at time 0.
        rate: Frame rate [1/s].
        always: Whether constant values get a key, too.
    """

    def __init__(self, start: int, rate: float, *, always: bool) -> None:
        self._start = start
        self._rate = rate
        self._always = always

    def number(self, path: str, track: _Track, interpolation: int) -> Iterator[Channel]:
        """Yield the channel of a scalar, if it needs keys."""
        values = np.asarray(track.values, np.float32)
        if self._always or np.ptp(values) > 0.0:
            yield self._channel(path, 0, track.times, values, "", interpolation)

    def transform(
        self, track: _Track | None, owner: bpy.types.Object | bpy.types.PoseBone
    ) -> Iterator[Channel]:
        """Yield the channels of the ``matrix_basis`` of an object or bone, if it needs keys."""
        if track is None:
            return
        matrices = np.asarray(track.values, np.float64)
        if not self._always and np.ptp(matrices, axis=0).max() == 0.0:
            return
        prefix, group = "", "Object Transforms"
        if isinstance(owner, bpy.types.PoseBone):
            prefix, group = f"{owner.path_from_id()}.", owner.name
        locations, rotations, scales = decompose(matrices)
        owner.rotation_mode = "QUATERNION"
        for path, rows in (
            ("location", locations),
            ("rotation_quaternion", rotations),
            ("scale", scales),
        ):
            # Decomposing single-precision matrices leaves noise.
            constant = np.ptp(rows, axis=0).max() < _NUMERIC_NOISE
            if constant and not self._always:
                setattr(owner, path, rows[0].tolist())
                continue
            keyed = rows[:1] if constant else rows
            for index, column in enumerate(keyed.T):
                times = track.times[: len(column)]
                yield self._channel(prefix + path, index, times, column.astype(np.float32), group)

    def _channel(
        self,
        path: str,
        index: int,
        times: NDArray[np.float64],
        values: NDArray[np.float32],
        group: str,
        interpolation: int | None = None,
    ) -> Channel:
        kept = significant_keys(values)
        # So that a time on a frame, or on half of one, is exactly there.
        frames = np.round(self._start + times[kept] * self._rate, 4)
        channel = Channel(path, index, frames, values[kept], group=group)
        return channel if interpolation is None else replace(channel, interpolation=interpolation)


def decompose(
    matrices: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Decompose transforms, shape [K, 4, 4], as Blender does.

    Returns:
        Locations [K, 3], quaternions (w, x, y, z) [K, 4] and scales [K, 3]. Shear is dropped, and a
        mirrored transform has three negative scales. Successive quaternions do not flip in sign.
    """
    linear = matrices[:, :3, :3]
    scales = np.linalg.norm(linear, axis=1)
    scales = np.where(np.linalg.det(linear)[:, None] < 0.0, -scales, scales)
    rotations = linear / np.where(scales == 0.0, 1.0, scales)[:, None, :]
    quaternions = quaternions_from_matrices(rotations)[:, [3, 0, 1, 2]]
    signs = np.where((quaternions[1:] * quaternions[:-1]).sum(1) < 0.0, -1.0, 1.0)
    quaternions[1:] *= np.cumprod(signs)[:, None]
    return matrices[:, :3, 3], quaternions, scales


def _tracks(
    parts: Sequence[Steps], array: str, names_of: Callable[[Layout], Sequence[Any]]
) -> dict[Any, _Track]:
    """Tracks by name, over all parts in which the name was recorded."""
    times: dict[Any, list[NDArray[np.float64]]] = {}
    values: dict[Any, list[NDArray[Any]]] = {}
    for part in parts:
        for column, name in enumerate(names_of(part.layout)):
            times.setdefault(name, []).append(part.times)
            values.setdefault(name, []).append(getattr(part, array)[:, column])
    return {
        name: _Track(np.concatenate(times[name]), np.concatenate(values[name])) for name in times
    }


def _key_tools(
    scene: bpy.types.Scene, take: Take, builder: _ChannelBuilder, name: str
) -> list[str]:
    """Make a collider of each tool that touched the clay, and return the object names."""
    _remove_tools(scene)
    poses = _tracks(take.steps, "tool_poses", lambda layout: layout.tools)
    names = []
    for number in poses:
        contact = _contact_track(take.steps, number)
        if not contact.values.any():
            continue
        item = _tool_object(take.tools[number], scene, f"{name} tool")
        _tool_collection(scene).objects.link(item)
        matrices = np.asarray(poses[number].values, np.float64).copy()
        matrices[:, :3, 3] /= take.header.unit_scale
        channels = [
            *builder.transform(_Track(poses[number].times, matrices), item),
            *builder.number("tactile_clay.collider_enabled", contact, CONSTANT),
        ]
        write_channels(item, f"{name} {item.name}", channels)
        names.append(item.name)
    return names


def _contact_track(parts: Sequence[Steps], number: int) -> _Track:
    """Whether a tool touches the clay; False while another tool was used."""
    times, values = [], []
    for part in parts:
        tools = part.layout.tools
        used = number in tools
        times.append(part.times if used else part.times[:1])
        values.append(part.tool_enabled[:, tools.index(number)] if used else np.zeros(1, bool))
    return _Track(np.concatenate(times), np.concatenate(values))


def _tool_object(tool: ToolShape, scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(from_meters(scene, tool.vertices).tolist(), [], tool.faces.tolist())
    item = bpy.data.objects.new(name, mesh)
    item[TAKE_TOOL] = True
    # As in the live session, only the effect of the tool should be visible.
    item.hide_render = True
    # A wireframe would hide the dent.
    item.display_type = "BOUNDS"
    properties = item.tactile_clay
    properties.role = "COLLIDER"
    properties.collider_kind = "MESH"
    properties.collider_friction = tool.friction
    return item


def _remove_tools(scene: bpy.types.Scene) -> None:
    """Remove the tools of an earlier take; they remain in its folder."""
    for collection in scene.collection.children:
        if collection.get(TAKE_TOOL):
            for item in list(collection.objects):
                if item.get(TAKE_TOOL):
                    bpy.data.objects.remove(item)


def _tool_collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    """The collection of tools, created if missing."""
    for collection in scene.collection.children:
        if collection.get(TAKE_TOOL):
            return collection
    collection = bpy.data.collections.new(TOOL_COLLECTION)
    collection[TAKE_TOOL] = True
    scene.collection.children.link(collection)
    return collection
