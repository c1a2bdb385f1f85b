# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting, stopping and recording tracked hands, and importing a recording."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.tracking import TrackingError
from ..core.tracking.recording.recording import read_recording
from . import live
from .keyframes import import_recording


class CLAY_OT_tracking_start(bpy.types.Operator):  # noqa: N801
    """Let the hands' armatures follow a tracker, whose sender runs beside Blender"""

    bl_idname = "clay.tracking_start"
    bl_label = "Start Tracking"
    bl_options = {"REGISTER"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Open the receiver and start the timer."""
        try:
            session = live.running.start(context.scene)
        except TrackingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Listening on port {session.receiver.address[1]} of this machine")
        return {"FINISHED"}


class CLAY_OT_tracking_stop(bpy.types.Operator):  # noqa: N801
    """Let go of the tracker; the hands stay as they are"""

    bl_idname = "clay.tracking_stop"
    bl_label = "Stop Tracking"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while tracking runs."""
        return live.running.session is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Stop the timer and close the receiver."""
        problem = live.running.stop()
        if problem:
            self.report({"ERROR"}, problem)
        return {"FINISHED"}


class CLAY_OT_tracking_record(bpy.types.Operator):  # noqa: N801
    """Record what arrives from the tracker, or end the recording"""

    bl_idname = "clay.tracking_record"
    bl_label = "Record"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while tracking runs."""
        return live.running.session is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Begin or end."""
        session = live.running.session
        if session is None:
            self.report({"ERROR"}, "Tracking does not run. Press Start Tracking first.")
            return {"CANCELLED"}
        try:
            if session.recorder is None:
                path = _next_path(context.scene)
                session.record(path)
                self.report({"INFO"}, f"Recording into {path.name}")
                return {"FINISHED"}
            written = session.stop_recording()
        except TrackingError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if written is None:
            self.report({"WARNING"}, "Nothing arrived, so nothing was recorded")
        else:
            self.report({"INFO"}, f"Recorded: {written}")
        return {"FINISHED"}


class CLAY_OT_tracking_import(bpy.types.Operator):  # noqa: N801
    """Put a recording of hands on their armatures as keyframes, so that it can be baked"""

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
        """Ask for the file."""
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read the recording and write the keys."""
        scene = context.scene
        path = Path(bpy.path.abspath(self.filepath))
        try:
            if live.running.session is not None:
                raise TrackingError("Stop tracking first: it would move the hands off their keys.")
            done = import_recording(
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
        self.report(
            {"INFO"}, f"{' and '.join(done.sides)} hand: keys on frames {done.first} to {done.last}"
        )
        return {"FINISHED"}


def _next_path(scene: bpy.types.Scene) -> Path:
    """A free name in the folder of recordings.

    Raises:
        TrackingError: The folder is beside a .blend that was never saved.
    """
    folder = scene.tactile_clay_tracking.recording_folder
    if folder.startswith("//") and not bpy.data.filepath:
        raise TrackingError("Save the .blend first, or choose a folder for recordings.")
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
