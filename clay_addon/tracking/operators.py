# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that start, stop and record tracking, and import a recording."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.tracking import TrackingError
from ..core.tracking.recording.recording import read_recording
from . import live
from .keyframes import import_recording


class CLAY_OT_tracking_start(bpy.types.Operator):  # noqa: N801
    """Make hand armatures follow a tracker. Its sender is started as a separate process"""

    bl_idname = "clay.tracking_start"
    bl_label = "Start Tracking"
    bl_options = {"REGISTER"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Open the receiver and start the timer."""
        try:
            session = live.tracking.start(context.scene)
        except TrackingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Listening on port {session.receiver.address[1]} of this machine")
        return {"FINISHED"}


class CLAY_OT_tracking_stop(bpy.types.Operator):  # noqa: N801
    """Stop following the tracker; the hands keep their poses"""

    bl_idname = "clay.tracking_stop"
    bl_label = "Stop Tracking"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Allow this only while tracking runs."""
        return live.tracking.session is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Stop the timer and close the receiver."""
        problem = live.tracking.stop()
        if problem:
            self.report({"ERROR"}, problem)
        return {"FINISHED"}


class CLAY_OT_tracking_record(bpy.types.Operator):  # noqa: N801
    """Start or stop recording the tracked hands"""

    bl_idname = "clay.tracking_record"
    bl_label = "Record"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Allow this only while tracking runs."""
        return live.tracking.session is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Start or stop recording."""
        session = live.tracking.session
        if session is None:
            self.report({"ERROR"}, "Tracking is not running. Press Start Tracking first.")
            return {"CANCELLED"}
        try:
            if session.recorder is None:
                path = _next_path(context.scene)
                session.record(path)
                self.report({"INFO"}, f"Recording to {path.name}")
                return {"FINISHED"}
            written = session.stop_recording()
        except TrackingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if written is None:
            self.report({"WARNING"}, "Nothing was recorded, because no frames arrived")
        else:
            self.report({"INFO"}, f"Saved recording {written}")
        return {"FINISHED"}


class CLAY_OT_tracking_import(bpy.types.Operator):  # noqa: N801
    """Import a recording of hands as keyframes on their armatures, so that it can be baked"""

    bl_idname = "clay.tracking_import"
    bl_label = "Import Recording"
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(
        default="*.jsonl;*.json;*.jsonl.gz;*.json.gz;*.part", options={"HIDDEN"}
    )
    use_current_frame: bpy.props.BoolProperty(
        name="At Current Frame",
        description="Start at the current frame rather than at the scene's first",
        default=False,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the recording and insert the keyframes."""
        scene = context.scene
        path = Path(bpy.path.abspath(self.filepath))
        try:
            if live.tracking.session is not None:
                raise TrackingError("Stop tracking first: it would override the keyframes.")
            imported = import_recording(
                scene,
                read_recording(path),
                live.hand_armatures(scene),
                start=scene.frame_current if self.use_current_frame else scene.frame_start,
                name=path.name.partition(".")[0],
                origin=scene.tactile_clay_tracking.origin,
            )
        except TrackingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        hands = f"{' and '.join(imported.sides)} hand".capitalize()
        frames = f"frames {imported.first} to {imported.last}"
        self.report({"INFO"}, f"{hands}: keyframes on {frames}")
        return {"FINISHED"}


def _next_path(scene: bpy.types.Scene) -> Path:
    """An unused path in the folder for recordings.

    Raises:
        TrackingError: The folder is relative to a .blend file that has not been saved.
    """
    folder = scene.tactile_clay_tracking.recording_folder
    if folder.startswith("//") and not bpy.data.filepath:
        raise TrackingError("Save the .blend file first, or choose a folder for recordings.")
    directory = Path(bpy.path.abspath(folder))
    number = 1
    while True:
        path = directory / f"hands-{number:03d}.jsonl"
        if not path.exists() and not path.with_name(path.name + ".part").exists():
            return path
        number += 1


_CLASSES = (
    CLAY_OT_tracking_start,
    CLAY_OT_tracking_stop,
    CLAY_OT_tracking_record,
    CLAY_OT_tracking_import,
)


def register() -> None:
    """Register the operators."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Unregister the operators."""
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
