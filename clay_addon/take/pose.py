# SPDX-License-Identifier: GPL-3.0-or-later
"""Poses recorded in a take: armatures of hands, colliders, and all objects that move them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.take.data import Layout
from ..hands.hand import hand_objects
from ..model.clay_scene import collider_objects, is_enabled
from ..model.collider import TAKE_TOOL
from ..tracking.armature import CONTACT_PROPERTY


class StepRow(NamedTuple):
    """Poses of hands and tools in one step: one row of each array of `Steps`."""

    objects: NDArray[np.float32]
    bones: NDArray[np.float32]
    contacts: NDArray[np.float32]
    enabled: NDArray[np.bool_]
    tool_poses: NDArray[np.float32]
    tool_enabled: NDArray[np.bool_]


def recorded_layout(scene: bpy.types.Scene, tools: tuple[int, ...] = ()) -> Layout:
    """Find the objects of a scene to record in a take.

    These are clay hands, colliders, and the objects they depend on: parents, armatures and the
    targets of constraints.

    Args:
        scene: The scene.
        tools: Numbers of the tools moved with the mouse.
    """
    found: dict[str, bpy.types.Object] = {}
    colliders = [item for item in collider_objects(scene) if TAKE_TOOL not in item]
    pending: list[bpy.types.Object] = [*hand_objects(scene), *colliders]
    while pending:
        item = pending.pop(0)
        if item.name in found or item.library is not None:
            continue
        found[item.name] = item
        pending += _dependencies(item)
    armatures = [item for item in found.values() if item.type == "ARMATURE"]
    return Layout(
        objects=tuple(found),
        armatures=tuple((item.name, tuple(item.pose.bones.keys())) for item in armatures),
        colliders=tuple(item.name for item in colliders if item.library is None),
        tools=tools,
    )


def read_poses(
    layout: Layout,
    depsgraph: bpy.types.Depsgraph,
    tools: list[tuple[NDArray[np.floating], bool]] | None = None,
) -> StepRow:
    """Read the current poses of hands and tools.

    Args:
        layout: Result of `recorded_layout`.
        depsgraph: The evaluated scene.
        tools: Transform from local to world space [m], shape [4, 4], of each tool, and whether it
            touches the clay.

    Raises:
        LookupError: An object is missing or has changed; call `recorded_layout` again.
    """
    evaluated = {
        name: bpy.data.objects[name].evaluated_get(depsgraph)
        for name in dict.fromkeys((*layout.objects, *layout.colliders))
    }
    objects = np.array([evaluated[name].matrix_basis for name in layout.objects], np.float32)
    bones = [np.zeros((0, 4, 4), np.float32)]
    contacts = []
    for name, bone_names in layout.armatures:
        armature = evaluated[name]
        if len(armature.pose.bones) != len(bone_names):
            raise LookupError(f"{name!r} no longer has the same bones.")
        values = np.empty((len(bone_names), 4, 4), np.float32)
        armature.pose.bones.foreach_get("matrix_basis", values.ravel())
        # Blender stores matrices in column-major order.
        bones.append(values.swapaxes(1, 2))
        contact = armature.get(CONTACT_PROPERTY, 1.0)
        contacts.append(float(contact) if isinstance(contact, int | float) else 0.0)
    enabled = [is_enabled(bpy.data.objects[name], depsgraph) for name in layout.colliders]
    tools = tools or []
    if len(tools) != len(layout.tools):
        raise LookupError(f"{len(tools)} tools were given, but {len(layout.tools)} are recorded.")
    return StepRow(
        objects.reshape(-1, 4, 4),
        np.concatenate(bones),
        np.array(contacts, np.float32),
        np.array(enabled, bool),
        np.array([pose for pose, _ in tools], np.float32).reshape(-1, 4, 4),
        np.array([touches for _, touches in tools], bool),
    )


def _dependencies(item: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """Objects whose motion moves or deforms an object."""
    if item.parent is not None:
        yield item.parent
    for modifier in item.modifiers:
        if modifier.type == "ARMATURE" and modifier.object is not None:
            yield modifier.object
    constraints = list(item.constraints)
    if item.type == "ARMATURE":
        constraints += [each for bone in item.pose.bones for each in bone.constraints]
    for constraint in constraints:
        target = getattr(constraint, "target", None)
        if target is not None:
            yield target
