# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators to bake, resume and free, with progress in the interface and Esc to stop."""

from collections.abc import Generator

import bpy

from ...solver.core.errors import TactileClayError
from ..base.activity import clay_activity
from ..base.modal import SteppedOperator
from ..core.readable import duration_text, size_text
from ..playback import playback
from .bake import BakeProgress, BakeResult, bake_steps, free


class _BakeOperator(SteppedOperator[BakeProgress, BakeResult]):
    """Base of Bake and Resume."""

    stopped_text = "Stopped. The frames so far are kept; Resume continues."
    _resume = False

    def begin(self, context: bpy.types.Context) -> Generator[BakeProgress, bool | None, BakeResult]:
        """Bake the scene's frame range."""
        return bake_steps(context, resume=self._resume)

    def status(self, step: BakeProgress) -> str:
        """Current frame and remaining time."""
        return (
            f"Baking clay: frame {step.frame}, {step.done} of {step.total}, "
            f"{duration_text(step.seconds_left)} left   Esc: stop"
        )

    def stepped(self, context: bpy.types.Context) -> None:
        """Show the frame that was just baked."""
        playback.refresh(context.scene, during_bake=True)

    def ended(self, context: bpy.types.Context) -> None:
        """Show the scene's frame again."""
        playback.refresh(context.scene)

    def report_result(self, result: BakeResult) -> None:
        """Report the number of frames baked, and all warnings."""
        for warning in result.warnings:
            self.report({"WARNING"}, warning)
        self.report(
            {"INFO"},
            f"{result.baked} frames baked, {result.kept} kept, in {duration_text(result.seconds)}",
        )


class CLAY_OT_bake(_BakeOperator, bpy.types.Operator):  # noqa: N801
    """Simulate the clay over the frame range from the start; Esc stops and keeps finished frames"""

    bl_idname = "clay.bake"
    bl_label = "Bake"
    bl_options = {"REGISTER"}


class CLAY_OT_resume(_BakeOperator, bpy.types.Operator):  # noqa: N801
    """Continue a bake at its first missing frame, with the same result as without interruption"""

    bl_idname = "clay.resume"
    bl_label = "Resume"
    bl_options = {"REGISTER"}
    _resume = True


class CLAY_OT_free(bpy.types.Operator):  # noqa: N801
    """Remove the bake from disk and show the clay in its rest state"""

    bl_idname = "clay.free"
    bl_label = "Free"
    bl_options = {"REGISTER", "UNDO"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for confirmation, since Undo cannot restore files."""
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove the bake."""
        try:
            clay_activity.check_free()
            size = free(context.scene)
        except TactileClayError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{size_text(size)} freed")
        return {"FINISHED"}


_CLASSES = (CLAY_OT_bake, CLAY_OT_resume, CLAY_OT_free)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators; Blender ends a running bake."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
