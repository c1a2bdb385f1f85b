# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracking settings stored in the .blend file: ``Scene.tactile_clay_tracking``."""

import bpy

from ..core.tracking.protocol.packet import PORT


def _is_armature(_: object, item: bpy.types.Object) -> bool:
    return item.type == "ARMATURE"


class ClayTrackingProperties(bpy.types.PropertyGroup):
    """Armatures of the hands, source of the tracking, port and recordings."""

    left: bpy.props.PointerProperty(
        name="Left Hand",
        description="Armature that follows the left hand",
        type=bpy.types.Object,
        poll=_is_armature,
    )
    right: bpy.props.PointerProperty(
        name="Right Hand",
        description="Armature that follows the right hand",
        type=bpy.types.Object,
        poll=_is_armature,
    )
    origin: bpy.props.PointerProperty(
        name="Tracker",
        description=(
            "Object at the position and rotation of the tracker, which the hands move relative to. "
            "Without one, the tracker is at the world origin"
        ),
        type=bpy.types.Object,
    )
    source: bpy.props.EnumProperty(
        name="Source",
        description="Tracker to use. Its sender is started with tracking and stopped with it",
        items=(
            ("OTHER", "External Sender", "A sender started outside Blender, such as in a terminal"),
            ("LEAPC", "Ultraleap", "An Ultraleap device, through Ultraleap's software"),
            ("LEAP", "Leap (Older Service)", "A Leap device, through its service's websocket"),
            ("OPENXR", "OpenXR", "A headset, through the computer's OpenXR runtime"),
            ("HTS", "Quest", "A Meta Quest with Hand Tracking Streamer, over the network"),
            ("MEDIAPIPE", "Webcam", "The first camera, through MediaPipe (set up separately)"),
            ("RECORDING", "Recording", "A recording, played in a loop"),
        ),
        default="OTHER",
    )
    recording: bpy.props.StringProperty(
        name="Recording",
        description="Recording to play, made with this add-on or LeapJS Playback",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    )
    port: bpy.props.IntProperty(
        name="Port",
        description="Port on this computer that senders send to",
        default=PORT,
        min=1024,
        max=65535,
    )
    recording_folder: bpy.props.StringProperty(
        name="Recordings",
        description="Folder for new recordings; // is the folder of the .blend file",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        default="//hand_recordings",
    )


def register() -> None:
    """Register the property group and add it to scenes."""
    bpy.utils.register_class(ClayTrackingProperties)
    bpy.types.Scene.tactile_clay_tracking = bpy.props.PointerProperty(type=ClayTrackingProperties)


def unregister() -> None:
    """Remove the property group; values stored in .blend files are kept."""
    del bpy.types.Scene.tactile_clay_tracking
    bpy.utils.unregister_class(ClayTrackingProperties)
