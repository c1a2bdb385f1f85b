# SPDX-License-Identifier: GPL-3.0-or-later
"""Potter's wheels while clay is worked live: they turn by the clock."""

from __future__ import annotations

import math

import bpy
import numpy as np

from .speed import RATE, limited
from .wheel import angle_curve, axle_angle, ensure_axle, live_scenes, refresh, wheel_objects


class LiveWheels:
    """The wheels of a scene whose clay is worked live: they turn by the clock, not the timeline.

    Whoever steps the clay calls `advance` before each step, and tells the solver then where
    colliders are, as always.

    Args:
        scene: Until `end` nothing else turns its wheels.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        refresh(scene)
        self._uid = scene.session_uid
        live_scenes.add(self._uid)
        self._angles = {item.name: axle_angle(item) for item in wheel_objects(scene)}

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self._angles)

    def advance(self, scene: bpy.types.Scene, duration: float) -> None:
        """Turn each wheel on, by what its speed is now.

        Args:
            scene: The same one; Undo replaces it.
            duration: Of the step to come [s].
        """
        for item in wheel_objects(scene):
            axle = ensure_axle(
                item, {i.tactile_clay.wheel_axle for i in scene.objects if i != item}
            )
            curve = angle_curve(axle)
            if curve is not None and not curve.mute:
                curve.mute = True
            speed = float(limited(np.array(item.tactile_clay.wheel_speed)))
            # Whole turns are left out, so that hours of turning lose no precision.
            before = self._angles.get(item.name, 0.0)
            angle = math.remainder(before + speed * RATE * duration, math.tau)
            self._angles[item.name] = angle
            if abs(axle.rotation_euler[2] - angle) > 1e-6:
                axle.rotation_euler[2] = angle

    def press_pedal(self, scene: bpy.types.Scene, change: float) -> None:
        """Make all wheels that have turned faster or slower.

        Args:
            scene: The same one.
            change: Of their speed [rpm].
        """
        for name in self._angles:
            item = scene.objects.get(name)
            if item is not None:
                item.tactile_clay.wheel_speed += change

    def end(self, scene: bpy.types.Scene) -> None:
        """Give the wheels back to the timeline, as they stand; once is enough.

        Their phases are set so that they stand like this at the scene's current frame.
        """
        if self._uid not in live_scenes:
            return
        live_scenes.discard(self._uid)
        refresh(scene)
        for item in wheel_objects(scene):
            curve = angle_curve(item.tactile_clay.wheel_axle)
            if curve is None or item.name not in self._angles:
                continue
            curve.mute = False
            behind = self._angles[item.name] - curve.evaluate(scene.frame_current_final)
            phase = item.tactile_clay.wheel_phase + behind
            item.tactile_clay.wheel_phase = math.remainder(phase, math.tau)
        refresh(scene)
