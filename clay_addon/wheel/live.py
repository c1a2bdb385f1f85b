# SPDX-License-Identifier: GPL-3.0-or-later
"""Potter's wheels in a live session, where they follow real time instead of the timeline."""

from __future__ import annotations

import math

import bpy
import numpy as np

from .speed import RPM, clamped_speeds
from .wheel import angle_curve, axle_angle, ensure_axle, live_scenes, refresh, wheel_objects


class LiveWheels:
    """The wheels of a scene during a live session.

    Call `advance` before each step of the clay, and then update the solver's colliders.

    Args:
        scene: The scene; until `end` nothing else turns its wheels.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        refresh(scene)
        self._uid = scene.session_uid
        live_scenes.add(self._uid)
        self._angles = {item.name: axle_angle(item) for item in wheel_objects(scene)}

    def __bool__(self) -> bool:
        """Whether there are any wheels."""
        return bool(self._angles)

    def advance(self, scene: bpy.types.Scene, duration: float) -> None:
        """Turn each wheel at its current speed.

        Args:
            scene: The same scene, passed anew as Undo replaces the object.
            duration: Duration of the next step [s].
        """
        for item in wheel_objects(scene):
            axle = ensure_axle(
                item, {i.tactile_clay.wheel_axle for i in scene.objects if i != item}
            )
            curve = angle_curve(axle)
            if curve is not None and not curve.mute:
                curve.mute = True
            speed = float(clamped_speeds(np.array(item.tactile_clay.wheel_speed)))
            # Kept within half a turn, so that precision does not degrade over hours.
            before = self._angles.get(item.name, 0.0)
            angle = math.remainder(before + speed * RPM * duration, math.tau)
            self._angles[item.name] = angle
            if abs(axle.rotation_euler[2] - angle) > 1e-6:
                axle.rotation_euler[2] = angle

    def change_speeds(self, scene: bpy.types.Scene, change: float) -> None:
        """Make all wheels that have turned faster or slower.

        Args:
            scene: The same scene.
            change: Change of their speed [rpm].
        """
        for name in self._angles:
            item = scene.objects.get(name)
            if item is not None:
                item.tactile_clay.wheel_speed += change

    def end(self, scene: bpy.types.Scene) -> None:
        """Return the wheels to the timeline; a second call does nothing.

        Their phases are set so that their angles at the scene's current frame do not change.
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
