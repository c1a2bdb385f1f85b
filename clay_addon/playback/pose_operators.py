# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators for keying sculpted shapes, removing keys, and continuing to sculpt a keyed shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from ..base.clock import shown_moment
from ..model.clay_scene import clay_objects, read_points
from .packed import is_packed, packed_positions
from .poses import PoseError, apply_pose, has_poses, key_clay, key_pose, pose_at, remove_key


def chosen_clay(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected clay, or all clay of the scene if none is selected."""
    clay = clay_objects(context.scene)
    return [item for item in clay if item in context.selected_objects] or clay


def own_positions(scene: bpy.types.Scene, clay: bpy.types.Object) -> NDArray[np.float32]:
    """A clay object's own shape at the current frame, sculpted or simulated, ignoring poses.

    Returns:
        Positions in the object's coordinates [Blender units], shape [N, 3].

    Raises:
        PoseError: It has no particles.
    """
    if is_packed(clay):
        return packed_positions(clay, shown_moment(scene))
    positions = read_points(clay, "position")
    if positions is None or not len(positions):
        raise PoseError(f"{clay.name!r} has no particles.")
    return positions


def key_shapes(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Key the current shape of the selected clay, or of all clay, at the current frame.

    Returns:
        The clay that was keyed.

    Raises:
        PoseError: There is no clay, or a shape cannot be keyed.
    """
    scene = context.scene
    clay = chosen_clay(context)
    if not clay:
        raise PoseError("There is no clay in this scene. Make clay first.")
    shapes = [own_positions(scene, item) for item in clay]
    for item, shape in zip(clay, shapes, strict=True):
        key_pose(item, shape, time=scene.frame_current_final)
    return clay


class _PoseOperator:
    """Common parts of the operators."""

    report: Any
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Available if there is clay."""
        return bool(clay_objects(context.scene))

    def _each(self, context: bpy.types.Context, act: Callable[[Any], bool], nothing: str) -> Any:
        try:
            done = [item.name for item in chosen_clay(context) if act(item)]
        except PoseError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not done:
            self.report({"ERROR"}, nothing)
            return {"CANCELLED"}
        return {"FINISHED"}


class CLAY_OT_pose_key(_PoseOperator, bpy.types.Operator):  # noqa: N801
    """Insert a keyframe with the current shape of the clay, held until the next keyframe"""

    bl_idname = "clay.pose_key"
    bl_label = "Key This Pose"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Key the selected clay, or all clay."""
        try:
            keyed = key_shapes(context)
        except PoseError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        names = ", ".join(item.name for item in keyed)
        self.report({"INFO"}, f"Frame {context.scene.frame_current}: pose of {names} keyed")
        return {"FINISHED"}


class CLAY_OT_pose_release(_PoseOperator, bpy.types.Operator):  # noqa: N801
    """From this frame on, show the simulated or sculpted clay instead of a keyed pose"""

    bl_idname = "clay.pose_release"
    bl_label = "Key the Clay Itself"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Key the selected clay, or all clay."""

        def act(item: bpy.types.Object) -> bool:
            key_clay(item, time=context.scene.frame_current_final)
            return has_poses(item)

        return self._each(context, act, "No pose is keyed, so the clay itself is already shown.")


class CLAY_OT_pose_remove(_PoseOperator, bpy.types.Operator):  # noqa: N801
    """Remove the clay's keyed pose at this frame"""

    bl_idname = "clay.pose_remove"
    bl_label = "Remove Pose"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove it from the selected clay, or all."""
        time = context.scene.frame_current_final
        return self._each(
            context,
            lambda item: remove_key(item, time=time),
            f"No pose is keyed at frame {context.scene.frame_current}.",
        )


class CLAY_OT_pose_take(_PoseOperator, bpy.types.Operator):  # noqa: N801
    """Replace the clay with the displayed pose, to sculpt it further or bake from it"""

    bl_idname = "clay.pose_take"
    bl_label = "Work on This Pose"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Take it for the selected clay, or all."""
        time = context.scene.frame_current_final
        return self._each(
            context,
            lambda item: pose_at(item, time) is not None and apply_pose(item, time=time),
            "No keyed pose is shown at this frame.",
        )


_CLASSES = (CLAY_OT_pose_key, CLAY_OT_pose_release, CLAY_OT_pose_remove, CLAY_OT_pose_take)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
