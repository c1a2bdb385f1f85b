# SPDX-License-Identifier: GPL-3.0-or-later
"""A take as keyframes: hands, colliders and tools do on the timeline what they did live.

There is a key where each step of the solver ended, also between whole frames: that is what the clay
felt. Only what moved gets keys, and what had an action before, which might move it now.
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


class Keyed(NamedTuple):
    """What got keys."""

    first: int
    """First frame."""
    last: int
    """Last frame."""
    objects: tuple[str, ...]
    """Names of the objects with a new action."""
    missing: tuple[str, ...]
    """Names of objects of the take that are no longer in the file."""


class _Track(NamedTuple):
    """Values of one quantity over a take."""

    times: NDArray[np.float64]
    values: NDArray[Any]


def key_take(scene: bpy.types.Scene, take: Take, *, name: str = "Take") -> Keyed:
    """Put a take on the timeline.

    Each object that moved gets a new action; the one it had stays in the file. The tools
    of the mouse become colliders in their own collection, in place of those of an earlier take.

    Args:
        scene: The take's.
        take: What was recorded.
        name: Of the actions.
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
        clock = _Clock(first, rate, always=animated)
        channels = list(clock.transform(objects.get(object_name), item))
        if object_name in enabled:
            track = _Track(enabled[object_name].times, enabled[object_name].values)
            path = "tactile_clay.collider_enabled"
            channels += clock.number(path, track, CONSTANT)
        if item.type == "ARMATURE":
            for bone in item.pose.bones:
                channels += clock.transform(bones.get((object_name, bone.name)), bone)
            if channels or CONTACT_PROPERTY in item:
                path = f'["{CONTACT_PROPERTY}"]'
                channels += clock.number(path, contacts[object_name], CONSTANT)
        if channels:
            write_channels(item, f"{name} {object_name}", channels)
            keyed.append(object_name)
    tools = _key_tools(scene, take, _Clock(first, rate, always=True), name)
    return Keyed(first, last, (*keyed, *tools), tuple(missing))


class _Clock:
    """Makes channels of tracks.

    Args:
        start: Frame at time 0.
        rate: Frames in a second [1/s].
        always: Whether a constant value gets a key, too.
    """

    def __init__(self, start: int, rate: float, *, always: bool) -> None:
        self._start = start
        self._rate = rate
        self._always = always

    def number(self, path: str, track: _Track, interpolation: int) -> Iterator[Channel]:
        """The channel of a number."""
        values = np.asarray(track.values, np.float32)
        if self._always or np.ptp(values) > 0.0:
            yield self._channel(path, 0, track.times, values, "", interpolation)

    def transform(
        self, track: _Track | None, owner: bpy.types.Object | bpy.types.PoseBone
    ) -> Iterator[Channel]:
        """The channels of an object's or a bone's own transform, shape [K, 4, 4]."""
        if track is None:
            return
        matrices = np.asarray(track.values, np.float64)
        if not self._always and np.ptp(matrices, axis=0).max() == 0.0:
            return
        prefix, group = "", "Object Transforms"
        if isinstance(owner, bpy.types.PoseBone):
            prefix, group = f"{owner.path_from_id()}.", owner.name
        locations, turns, scales = decomposed(matrices)
        owner.rotation_mode = "QUATERNION"
        for path, rows in (
            ("location", locations),
            ("rotation_quaternion", turns),
            ("scale", scales),
        ):
            # Decomposing a matrix leaves noise of single precision.
            still = np.ptp(rows, axis=0).max() < _NUMERIC_NOISE
            if still and not self._always:
                setattr(owner, path, rows[0].tolist())
                continue
            shown = rows[:1] if still else rows
            for index, column in enumerate(shown.T):
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


def decomposed(
    matrices: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Location [K, 3], quaternion (w, x, y, z) [K, 4] and scale [K, 3] of transforms [K, 4, 4].

    Like Blender's own decomposition: without shear, mirroring in all three scales. Successive
    quaternions do not jump in sign.
    """
    linear = matrices[:, :3, :3]
    scales = np.linalg.norm(linear, axis=1)
    scales = np.where(np.linalg.det(linear)[:, None] < 0.0, -scales, scales)
    rotations = linear / np.where(scales == 0.0, 1.0, scales)[:, None, :]
    turns = quaternions_from_matrices(rotations)[:, [3, 0, 1, 2]]
    flips = np.where((turns[1:] * turns[:-1]).sum(1) < 0.0, -1.0, 1.0)
    turns[1:] *= np.cumprod(flips)[:, None]
    return matrices[:, :3, 3], turns, scales


def _tracks(
    parts: Sequence[Steps], array: str, names_of: Callable[[Layout], Sequence[Any]]
) -> dict[Any, _Track]:
    """The track of each name, over all parts in which it was recorded."""
    times: dict[Any, list[NDArray[np.float64]]] = {}
    values: dict[Any, list[NDArray[Any]]] = {}
    for part in parts:
        for row, name in enumerate(names_of(part.layout)):
            times.setdefault(name, []).append(part.times)
            values.setdefault(name, []).append(getattr(part, array)[:, row])
    return {
        name: _Track(np.concatenate(times[name]), np.concatenate(values[name])) for name in times
    }


def _key_tools(scene: bpy.types.Scene, take: Take, clock: _Clock, name: str) -> list[str]:
    """Turn the tools that the clay felt into colliders."""
    _remove_tools(scene)
    poses = _tracks(take.steps, "tool_poses", lambda layout: layout.tools)
    made = []
    for number in poses:
        felt = _felt(take.steps, number)
        if not felt.values.any():
            continue
        item = _tool_object(take.tools[number], scene, f"{name} tool")
        _tool_collection(scene).objects.link(item)
        matrices = np.asarray(poses[number].values, np.float64).copy()
        matrices[:, :3, 3] /= take.header.unit_scale
        channels = [
            *clock.transform(_Track(poses[number].times, matrices), item),
            *clock.number("tactile_clay.collider_enabled", felt, CONSTANT),
        ]
        write_channels(item, f"{name} {item.name}", channels)
        made.append(item.name)
    return made


def _felt(parts: Sequence[Steps], number: int) -> _Track:
    """When the clay felt a tool: not while another one was in the mouse."""
    times, values = [], []
    for part in parts:
        tools = part.layout.tools
        there = number in tools
        times.append(part.times if there else part.times[:1])
        values.append(part.tool_enabled[:, tools.index(number)] if there else np.zeros(1, bool))
    return _Track(np.concatenate(times), np.concatenate(values))


def _tool_object(tool: ToolShape, scene: bpy.types.Scene, name: str) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(from_meters(scene, tool.vertices).tolist(), [], tool.faces.tolist())
    item = bpy.data.objects.new(name, mesh)
    item[TAKE_TOOL] = True
    # The film shows what the tool does, as the session did.
    item.hide_render = True
    # Its wires would hide the dent that it leaves.
    item.display_type = "BOUNDS"
    properties = item.tactile_clay
    properties.role = "COLLIDER"
    properties.collider_kind = "MESH"
    properties.collider_friction = tool.friction
    return item


def _remove_tools(scene: bpy.types.Scene) -> None:
    """Remove the tools of an earlier take; its folder still has them."""
    for collection in scene.collection.children:
        if collection.get(TAKE_TOOL):
            for item in list(collection.objects):
                if item.get(TAKE_TOOL):
                    bpy.data.objects.remove(item)


def _tool_collection(scene: bpy.types.Scene) -> bpy.types.Collection:
    """The collection of tools."""
    for collection in scene.collection.children:
        if collection.get(TAKE_TOOL):
            return collection
    collection = bpy.data.collections.new(TOOL_COLLECTION)
    collection[TAKE_TOOL] = True
    scene.collection.children.link(collection)
    return collection
