# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames and animation time: the one place that knows of a scene's time remapping.

A bake, its playback, deliveries and rendered pictures are numbered by the scene's *frames*. Blender
evaluates keyframes, drivers and the Scene Time node at an *animation time*, which is the frame
stretched by the scene's time remapping (Output > Frame Range > Time Stretching).
"""

from __future__ import annotations

import math

import bpy


def shown_moment(scene: bpy.types.Scene) -> float:
    """The scene's current frame with its fraction, as motion blur asks for [frames].

    Before frame 0 Blender's fraction is negative.
    """
    return scene.frame_current + scene.frame_subframe


def go_to(scene: bpy.types.Scene, moment: float) -> None:
    """Bring a scene to a moment that `shown_moment` gave."""
    whole = math.floor(moment)
    scene.frame_set(whole, subframe=moment - whole)


def animation_time(scene: bpy.types.Scene, frame: float) -> float:
    """The time at which Blender evaluates keyframes when it shows a frame [keyframe units]."""
    return frame * scene.render.frame_map_old / scene.render.frame_map_new


def frame_at(scene: bpy.types.Scene, time: float) -> float:
    """The frame that shows an animation time; the inverse of `animation_time`."""
    return time * scene.render.frame_map_new / scene.render.frame_map_old


def drive_frame(owner: bpy.types.bpy_struct, path: str, index: int = -1) -> None:
    """Let a property follow the frame that the scene shows, fraction included.

    The driver needs no Python, so it runs in files from strangers and where the add-on is missing.

    Args:
        owner: What has the property.
        path: Its data path.
        index: Of an array's element; -1 for a property that is no array.
    """
    owner.driver_remove(path, index)
    driver = owner.driver_add(path, index).driver
    driver.type = "SCRIPTED"
    for name in ("old", "new"):
        variable = driver.variables.new()
        variable.name = name
        variable.type = "CONTEXT_PROP"
        variable.targets[0].context_property = "ACTIVE_SCENE"
        variable.targets[0].data_path = f"render.frame_map_{name}"
    driver.expression = "frame * new / old"
