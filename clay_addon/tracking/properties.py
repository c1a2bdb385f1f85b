# SPDX-License-Identifier: GPL-3.0-or-later
"""What a .blend keeps about tracked hands: ``Scene.tactile_clay_tracking``."""

import bpy

from ..core.tracking.protocol.packet import PORT


def _is_armature(_: object, item: bpy.types.Object) -> bool:
    return item.type == "ARMATURE"


class ClayTrackingProperties(bpy.types.PropertyGroup):
    """Which armatures follow which hands, and where they hear of them."""

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
            "Object that stands where the tracker does: hands move about it, and turn with it. "
            "Without one the tracker is at the world's origin"
        ),
        type=bpy.types.Object,
    )
    source: bpy.props.EnumProperty(
        name="Source",
        description="What sees the hands; its sender is started beside Blender, and ends with it",
        items=(
            ("OTHER", "Started elsewhere", "A sender that was started in a terminal"),
            ("LEAPC", "Ultraleap", "An Ultraleap device, through Ultraleap's software"),
            ("LEAP", "Leap (older service)", "A Leap device, through its service's websocket"),
            ("OPENXR", "OpenXR", "A headset, through the machine's OpenXR runtime"),
            ("HTS", "Quest", "A Meta Quest with Hand Tracking Streamer, over the network"),
            ("MEDIAPIPE", "Webcam", "The first camera, through MediaPipe, once that is set up"),
            ("RECORDING", "Recording", "A recording, played over and over"),
        ),
        default="OTHER",
    )
    recording: bpy.props.StringProperty(
        name="Recording",
        description="The recording to play: of this add-on, or of LeapJS Playback",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    )
    port: bpy.props.IntProperty(
        name="Port",
        description="Port on this machine that senders send to",
        default=PORT,
        min=1024,
        max=65535,
    )
    recording_folder: bpy.props.StringProperty(
        name="Recordings",
        description="Folder for recordings; // is the folder of the .blend file",
        subtype="DIR_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        default="//hand_recordings",
    )


def register() -> None:
    """Register the property group and hang it on scenes."""
    bpy.utils.register_class(ClayTrackingProperties)
    bpy.types.Scene.tactile_clay_tracking = bpy.props.PointerProperty(type=ClayTrackingProperties)


def unregister() -> None:
    """Take the property group away; what a .blend keeps stays in it."""
    del bpy.types.Scene.tactile_clay_tracking
    bpy.utils.unregister_class(ClayTrackingProperties)
