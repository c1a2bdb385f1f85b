# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand armatures for tests in Blender."""

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from tactile_clay.clay_addon.core.tracking.protocol.joints import FROM_ROOT, JOINT_NAMES, PARENTS
from tactile_clay.tests.clay_addon.core.tracking.hands import rig_bones


def add_hand(
    side: str = "right", *, kind: str = "openxr", name: str = "Hand", unit: float = 1.0
) -> Any:
    """Add an armature with the joints of a hand.

    Args:
        side: Left or right.
        kind: "openxr": bones with OpenXR's axes and parents; "parentless": the same without
            parents, like the WebXR hands; "animation": connected bones along the fingers, and a
            forearm, as in animation rigs.
        name: Name of the object.
        unit: Length of a Blender unit [m].
    """
    data = bpy.data.armatures.new(name)
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    bpy.context.view_layer.objects.active = item
    bpy.ops.object.mode_set(mode="EDIT")
    rest = rig_bones(side)
    animation = kind == "animation"
    if animation:
        forearm = data.edit_bones.new("forearm")
        forearm.head, forearm.tail = (0.0, -0.25 / unit, 0.0), (0.0, -1e-3 / unit, 0.0)
    for joint in FROM_ROOT:
        matrix = rest[JOINT_NAMES[joint]]
        head = matrix[:3, 3] / unit
        bone = data.edit_bones.new(JOINT_NAMES[joint])
        bone.head = head
        # Bones point along the finger in animation rigs, and out of the back of the hand for
        # OpenXR, whose -Z points along the finger.
        along = -matrix[:3, 2] if animation else matrix[:3, 1]
        following = [each for each, parent in enumerate(PARENTS) if parent == joint]
        length = 0.01 / unit
        if animation and len(following) == 1:
            length = np.linalg.norm(rest[JOINT_NAMES[following[0]]][:3, 3] / unit - head)
        bone.tail = head + along * length
        bone.align_roll(matrix[:3, 1] if animation else matrix[:3, 2])
        if PARENTS[joint] >= 0 and kind != "parentless":
            bone.parent = data.edit_bones[JOINT_NAMES[PARENTS[joint]]]
            if animation and (bone.parent.tail - bone.head).length < 1e-5 / unit:
                bone.use_connect = True
        elif animation:
            bone.parent = data.edit_bones["forearm"]
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()
    return item


def head_positions(item: Any) -> dict[str, np.ndarray]:
    """World positions of the bones' heads, by bone name [Blender units], shape [3]."""
    bpy.context.view_layer.update()
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    world = Matrix(evaluated.matrix_world)
    return {bone.name: np.array(world @ bone.head) for bone in evaluated.pose.bones}
